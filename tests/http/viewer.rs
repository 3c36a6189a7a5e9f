//! The viewer's files, as a browser gets them.

use reqwest::Method;

use crate::service::{Running, header, problem};

#[tokio::test(flavor = "multi_thread")]
async fn the_page_and_all_that_it_names_are_served_and_may_load_nothing_from_elsewhere() {
    let service = Running::start("").await;
    let response = service.get("/").await;
    assert_eq!(header(&response, "content-type"), "text/html; charset=utf-8");
    let policy = header(&response, "content-security-policy").to_owned();
    assert!(policy.starts_with("default-src 'self'; img-src 'self' blob:;"), "{policy}");
    assert!(!policy.contains("unsafe") && !policy.contains("http"), "{policy}");
    let link = header(&response, "link").to_owned();
    let modules =
        link.split(", ").map(|link| link.strip_suffix(">; rel=modulepreload").unwrap().trim_start_matches('<'));
    let page = response.text().await.unwrap();
    // Scripts and styles of the page itself are forbidden by the policy: it must not have any.
    assert!(!page.contains("style=") && !page.contains("<style") && !page.contains("<script>"), "{page}");
    let named = page.split("href=").skip(1).map(|rest| rest.split([' ', '>', '#']).next().unwrap());
    let files: Vec<_> = named.filter(|path| !path.is_empty()).chain(modules).collect();
    assert!(
        ["style.css", "icons.svg", "js/main.js", "js/warp.js"].iter().all(|path| files.contains(path)),
        "{files:?}"
    );
    for path in files {
        let response = service.get(&format!("/{path}")).await;
        assert_eq!(response.status(), 200, "{path}");
        let expected = match path.rsplit_once('.').unwrap().1 {
            "js" => "text/javascript; charset=utf-8",
            "css" => "text/css; charset=utf-8",
            _ => "image/svg+xml",
        };
        assert_eq!(header(&response, "content-type"), expected, "{path}");
        assert_eq!(header(&response, "x-content-type-options"), "nosniff", "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_the_browser_has_is_not_sent_again() {
    let service = Running::start("").await;
    for path in ["/", "/js/main.js"] {
        let etag = header(&service.get(path).await, "etag").to_owned();
        let again = service.request(Method::GET, path).header("if-none-match", &etag).send().await.unwrap();
        assert_eq!((again.status().as_u16(), header(&again, "etag")), (304, etag.as_str()), "{path}");
        assert!(again.bytes().await.unwrap().is_empty());
        let other = service.request(Method::GET, path).header("if-none-match", "\"other\"").send().await.unwrap();
        assert_eq!(other.status(), 200, "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn there_is_no_way_out_of_the_folder_of_modules() {
    let service = Running::start("").await;
    for path in ["/js/none.js", "/js/..%2Findex.html", "/js/%2E%2E%2F%2E%2E%2FCargo.toml", "/js/", "/web/index.html"] {
        let refused = problem(service.get(path).await).await;
        assert_eq!(refused["type"], "urn:shearwarp:problem:no-such-route", "{path}");
    }
}
