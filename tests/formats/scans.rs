//! Real scans, where the environment variable SHEARWARP_DATA names a folder of them: each file has
//! a `.json` beside it with its `dims`, `min` and `max`.

use std::path::Path;

use shearwarp::volume::decode::{Limits, load, volume_id};

#[test]
fn real_scans_have_the_dimensions_and_range_that_are_known_of_them() {
    let Some(folder) = std::env::var_os("SHEARWARP_DATA") else { return };
    let mut seen = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        let Some(id) = volume_id(path.file_name().unwrap().to_str().unwrap()) else { continue };
        let known = std::fs::read_to_string(Path::new(&folder).join(format!("{id}.json"))).unwrap();
        let known: serde_json::Value = serde_json::from_str(&known).unwrap();
        let volume = load(&path, &Limits::default()).unwrap();
        assert_eq!(serde_json::json!(volume.dims()), known["dims"], "{id}");
        let (low, high) = volume.value_range();
        assert_eq!((Some(low), Some(high)), (known["min"].as_f64(), known["max"].as_f64()), "{id}");
        let spacing = known["spacing"].as_array().unwrap().iter().map(|mm| mm.as_f64().unwrap());
        assert!(spacing.eq(volume.placement().spacing.to_array()), "{id}: {}", volume.placement().spacing);
        seen += 1;
    }
    assert!(seen > 0, "no volumes in {}", folder.display());
}
