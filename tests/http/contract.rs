//! openapi.yaml says what the service does, no more and no less.

use std::collections::BTreeSet;

use reqwest::Method;
use serde_yaml_ng::Value;
use shearwarp::classify::presets;
use shearwarp::encode::Format;
use shearwarp::render::Algorithm;
use shearwarp::service::request::{OPTIONS, RenderRequest};
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
fn its_algorithms_are_those_that_can_be_named_and_those_that_answers_name() {
    let document = document();
    let mut named: BTreeSet<_> =
        [Algorithm::Classified, Algorithm::FastClassification, Algorithm::Preintegrated, Algorithm::Raycast]
            .map(|algorithm| algorithm.name().to_owned())
            .into();
    assert_eq!(names(&document["components"]["headers"]["X-Render-Algorithm"]["schema"]["enum"]), named);
    named.insert("auto".into());
    assert_eq!(names(&document["components"]["schemas"]["Algorithm"]["enum"]), named);
}

#[test]
fn its_query_parameters_are_the_short_names() {
    let document = document();
    let expected: BTreeSet<_> = OPTIONS.iter().map(|option| option.name.to_owned()).collect();
    for extension in ["png", "jpg", "jpeg", "webp", "raw"] {
        let listed = &document["paths"][format!("/v1/volumes/{{id}}/frame.{extension}")]["parameters"];
        let parameters = listed.as_sequence().unwrap().iter().map(|parameter| resolved(&document, parameter));
        let queried: BTreeSet<_> = parameters
            .filter(|parameter| parameter["in"] == "query")
            .map(|parameter| parameter["name"].as_str().unwrap().to_owned())
            .collect();
        assert_eq!(queried, expected, "{extension}");
    }
}

/// A schema or parameter, or what its `$ref` leads to.
fn resolved<'a>(document: &'a Value, value: &'a Value) -> &'a Value {
    match value.get("$ref") {
        None => value,
        Some(reference) => {
            let path = reference.as_str().unwrap().strip_prefix("#/").unwrap();
            resolved(document, path.split('/').fold(document, |at, key| &at[key]))
        }
    }
}

/// Values of a property as JSON, each with whether the contract takes it.
fn samples(schema: &Value) -> Vec<(String, bool)> {
    let number = |key: &str| schema.get(key).map(|bound| bound.as_f64().unwrap());
    let mut samples = vec![("null".into(), false), ("[[]]".into(), false)];
    if let Some(list) = schema.get("enum") {
        samples.extend(names(list).iter().map(|name| (format!("{name:?}"), true)));
        samples.push(("\"nonsense\"".into(), false));
    }
    for (inclusive, exclusive, outwards) in
        [("minimum", "exclusiveMinimum", -1.0), ("maximum", "exclusiveMaximum", 1.0)]
    {
        if let Some(end) = number(inclusive) {
            samples.extend([(end.to_string(), true), ((end + outwards).to_string(), false)]);
        }
        if let Some(end) = number(exclusive) {
            samples.extend([(end.to_string(), false), ((end - 0.01 * outwards).to_string(), true)]);
        }
    }
    samples
}

/// At the ends of every range and for every name, schema and program agree.
#[test]
fn requests_are_taken_and_refused_as_its_schemas_say() {
    let document = document();
    let schemas = &document["components"]["schemas"];
    let mut tried = 0;
    for (schema, before, after) in [
        (&schemas["RenderRequest"], "", ""),
        (&schemas["Preintegration"], r#""preintegration": {"#, "}"),
        (&schemas["DepthCueing"], r#""depth_cueing": {"#, "}"),
        (&schemas["Window"], r#""blend": "average", "window": {"#, "}"),
        (&schemas["Shading"], r#""shading": {"#, "}"),
        (&schemas["Camera"]["oneOf"][0], r#""camera": {"#, "}"),
        (&schemas["Image"]["oneOf"][0], r#""image": {"#, "}"),
    ] {
        for (name, property) in schema["properties"].as_mapping().unwrap() {
            for (value, taken) in samples(resolved(&document, property)) {
                let text = format!("{{{before}{:?}: {value}{after}}}", name.as_str().unwrap());
                // The largest side is a limit of the service, not of the request.
                if name == "width" || name == "height" {
                    continue;
                }
                assert_eq!(RenderRequest::from_json(text.as_bytes()).is_ok(), taken, "{text}");
                tried += 1;
            }
        }
    }
    assert!(tried > 100, "{tried}");
}

#[test]
fn its_examples_are_requests() {
    let document = document();
    let body = &document["paths"]["/v1/volumes/{id}/frame"]["post"]["requestBody"]["content"]["application/json"];
    for (name, example) in body["examples"].as_mapping().unwrap() {
        let text = serde_json::to_vec(&example["value"]).unwrap();
        assert!(RenderRequest::from_json(&text).is_ok(), "{name:?}");
    }
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
