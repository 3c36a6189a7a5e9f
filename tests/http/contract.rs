//! openapi.yaml says what the service does, no more and no less.

use std::collections::BTreeSet;

use reqwest::Method;
use serde_yaml_ng::Value;
use shearwarp::classify::presets;
use shearwarp::encode::Format;
use shearwarp::service::router;

use crate::service::{Running, header};

fn document() -> Value {
    serde_yaml_ng::from_str(include_str!("../../openapi.yaml")).unwrap()
}

fn names(list: &Value) -> BTreeSet<String> {
    list.as_sequence().unwrap().iter().map(|name| name.as_str().unwrap().to_owned()).collect()
}

#[test]
fn it_lists_exactly_the_routers_paths() {
    let document = document();
    let documented: BTreeSet<_> =
        document["paths"].as_mapping().unwrap().keys().map(|p| p.as_str().unwrap().to_owned()).collect();
    assert_eq!(documented, router::paths().map(str::to_owned).collect());
}

#[tokio::test(flavor = "multi_thread")]
async fn every_path_has_exactly_its_methods() {
    let service = Running::start("").await;
    for (path, item) in document()["paths"].as_mapping().unwrap() {
        let mut expected: BTreeSet<_> = ["get", "post", "put", "delete", "patch"]
            .into_iter()
            .filter(|method| item.get(method).is_some())
            .map(str::to_uppercase)
            .collect();
        if expected.contains("GET") {
            expected.insert("HEAD".into());
        }
        let path = path.as_str().unwrap().replace("{id}", "ball").replace("{name}", "ct-bone");
        let response = service.request(Method::OPTIONS, &path).send().await.unwrap();
        assert_eq!(response.status(), 405, "{path}");
        let allowed: BTreeSet<_> = header(&response, "allow").split(',').map(str::to_owned).collect();
        assert_eq!(allowed, expected, "{path}");
    }
}

#[test]
fn its_lists_of_names_are_those_of_the_program() {
    let schemas = &document()["components"]["schemas"];
    assert_eq!(
        names(&schemas["PresetName"]["enum"]),
        presets::all().iter().map(|preset| preset.name.clone()).collect()
    );
    assert_eq!(names(&schemas["Format"]["enum"]), Format::ALL.map(|format| format.name().to_owned()).into());
    assert_eq!(document()["info"]["version"], env!("CARGO_PKG_VERSION"));
}

#[test]
fn its_largest_image_side_is_the_default_limit() {
    let defaults = include_str!("../../config/default.toml");
    let side = document()["components"]["schemas"]["Side"]["maximum"].as_u64().unwrap();
    assert!(defaults.contains(&format!("\nmax_side = {side}\n")), "{side}");
}

#[tokio::test(flavor = "multi_thread")]
async fn it_is_served_as_it_is() {
    let service = Running::start("").await;
    let response = service.get("/openapi.yaml").await;
    assert_eq!(header(&response, "content-type"), "application/yaml");
    assert_eq!(response.text().await.unwrap(), include_str!("../../openapi.yaml"));
}
