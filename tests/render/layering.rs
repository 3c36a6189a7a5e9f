//! Who may name whom: main -> service -> render -> classify -> volume, and meshes beside them, never upwards.

use std::fs;
use std::path::Path;

/// A folder (or file) of `src/` and the modules of the crate that it may name.
const MAY_NAME: [(&str, &[&str]); 9] = [
    ("simd.rs", &[]),
    ("volume", &["volume", "simd"]),
    ("classify", &["classify", "volume", "simd"]),
    ("mesh", &[]),
    ("render", &["render", "classify", "volume", "mesh", "raycast", "simd"]),
    ("raycast.rs", &["render", "classify", "volume"]),
    ("raycast", &["render", "classify", "volume"]),
    ("encode", &["encode", "render"]),
    ("service", &["service", "encode", "render", "classify", "volume", "mesh"]),
];

/// Words that only the service and the program may know.
const SERVICE_ONLY: [&str; 5] = ["tokio", "axum", "tracing::", "metrics::", "figment"];

fn sources(path: &Path, visit: &mut dyn FnMut(&Path, &str)) {
    if path.is_dir() {
        for entry in fs::read_dir(path).unwrap() {
            sources(&entry.unwrap().path(), visit);
        }
    } else if path.extension().is_some_and(|e| e == "rs") {
        visit(path, &fs::read_to_string(path).unwrap());
    }
}

#[test]
fn no_module_names_one_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut seen = 0;
    for (folder, allowed) in MAY_NAME {
        sources(&src.join(folder), &mut |path, text| {
            // Documentation may point anywhere.
            let code: String =
                text.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n");
            for named in code.split("crate::").skip(1) {
                let module: String = named.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
                assert!(allowed.contains(&module.as_str()), "{} names crate::{module}", path.display());
                seen += 1;
            }
            if folder != "service" {
                for word in SERVICE_ONLY {
                    assert!(!code.contains(word), "{} knows {word}", path.display());
                }
            }
        });
    }
    assert!(seen > 20, "the scan found only {seen} paths");
}
