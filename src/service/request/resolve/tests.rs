use glam::DVec3;

use super::*;
use crate::render::IntensityProjection;
use crate::volume::{ImportReport, Placement, ScalarType, Scalars};

const LIMITS: ImageLimits = ImageLimits { max_side: 4096, max_pixels: 4096 * 2048 };

fn volume() -> Volume {
    let scalars = Scalars::U8((0..5 * 6 * 7).map(|i| i as u8).collect());
    let placement = Placement::from_spacing(DVec3::new(1.0, 0.5, 2.0));
    Volume::new([5, 6, 7], placement, scalars, (1.0, 0.0), ImportReport::plain("test", ScalarType::U8)).unwrap()
}

fn resolve(json: &str) -> Result<ResolvedRequest, RequestError> {
    RenderRequest::from_json(json.as_bytes())?.resolve(&volume(), &FittedPresets::of(&volume(), None), &LIMITS)
}

fn pointer(result: Result<ResolvedRequest, RequestError>) -> String {
    match result {
        Err(RequestError::Refused(fields)) => fields[0].pointer.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_empty_request_has_every_default() {
    let resolved = resolve("{}").unwrap();
    assert_eq!(resolved.view.size(), (512, 512));
    assert_eq!(resolved.look.settings.algorithm, Algorithm::Preintegrated);
    assert_eq!(resolved.look.settings.shading, Some(Shading::default()));
    assert_eq!(resolved.look.settings.early_ray_termination, 0.99);
    assert_eq!(resolved.look.min_opacity, 0.002);
    assert_eq!(resolved.look.transfer.opacity_distance, Some(0.5));
    assert_eq!(resolved.format, None);
}

#[test]
fn auto_is_preintegrated_whatever_the_view_and_the_quality() {
    let algorithm = |json| resolve(json).unwrap().look.settings.algorithm;
    assert_eq!(algorithm(r#"{"quality": "draft"}"#), Algorithm::Preintegrated);
    assert_eq!(algorithm(r#"{"quality": "high"}"#), Algorithm::Preintegrated);
    assert_eq!(algorithm(r#"{"camera": {"projection": "perspective"}}"#), Algorithm::Preintegrated);
    assert_eq!(algorithm(r#"{"algorithm": "raycast"}"#), Algorithm::Raycast);
}

#[test]
fn a_projection_shows_the_range_of_values_unless_told() {
    let blend = |json: &str| resolve(json).unwrap().look.settings.blend;
    let window = Window { center: 104.5, width: 209.0 };
    assert_eq!(blend(r#"{"blend": "maximum"}"#), Blend::Projection(IntensityProjection::Maximum, window));
    for (told, center, width) in [(r#""center": 40, "width": 400"#, 40.0, 400.0), (r#""width": 9"#, 104.5, 9.0)] {
        let json = format!(r#"{{"blend": "average", "window": {{{told}}}}}"#);
        let window = Window { center, width };
        assert_eq!(blend(&json), Blend::Projection(IntensityProjection::Average, window));
    }
}

#[test]
fn quality_sets_termination_and_sample_distance() {
    let settings = |json| resolve(json).unwrap().look.settings;
    assert_eq!(settings(r#"{"quality": "draft"}"#).early_ray_termination, 0.98);
    assert_eq!(settings(r#"{"algorithm": "raycast"}"#).early_ray_termination, 0.9999);
    assert_eq!(settings(r#"{"algorithm": "raycast"}"#).sample_distance, 0.5);
    assert_eq!(settings(r#"{"quality": "high"}"#).sample_distance, 0.125);
    assert_eq!(settings(r#"{"quality": "high", "sample_distance": 1}"#).sample_distance, 1.0);
}

#[test]
fn equal_requests_written_differently_have_one_canonical_text() {
    let canonical = |json: &str| resolve(json).unwrap().canonical();
    let equal = [
        r#"{}"#,
        r#"{"camera": {"azimuth": -0.0, "zoom": 1.0}, "quality": "standard"}"#,
        r##"{"camera": {"azimuth": 360}, "image": {"background": "#000000", "format": "png", "width": 512.0}}"##,
        r#"{"early_ray_termination": 0.99, "min_opacity": 2e-3, "sample_distance": 3, "algorithm": "auto"}"#,
        r#"{"shading": {"lights": ["headlight"]}, "algorithm": "preintegrated", "blend": "composite"}"#,
        r#"{"preintegration": {"entries": 256, "lookup": "bilinear", "buffer": "image"}}"#,
        r#"{"clip": []}"#,
        r#"{"level": 0}"#,
        r#"{"image": {"stage": "final"}}"#,
    ];
    for json in equal {
        assert_eq!(canonical(json), canonical("{}"), "{json}");
    }
    let projection = canonical(r#"{"blend": "maximum"}"#);
    for further in [
        r#""window": {"center": 104.5, "width": 209}"#,
        r#""shading": false, "transfer_function": "gray-ramp", "depth_cueing": {}, "early_ray_termination": 1"#,
        r#""preintegration": {"samples_per_voxel": 1, "lookup": "nearest", "entries": 9}"#,
    ] {
        assert_eq!(canonical(&format!(r#"{{"blend": "maximum", {further}}}"#)), projection, "{further}");
    }
    let running_sums = canonical(r#"{"preintegration": {"table": "1d"}}"#);
    let with_entries = r#"{"preintegration": {"table": "1d", "entries": 512, "lookup": "nearest"}}"#;
    assert_eq!(canonical(with_entries), running_sums);
    let ray_cast = canonical(r#"{"algorithm": "raycast"}"#);
    assert_eq!(canonical(r#"{"algorithm": "raycast", "quality": "high", "sample_distance": 0.5}"#), ray_cast);
    let given = |distance: &str, light: &str| {
        canonical(&format!(
            r##"{{"transfer_function": {{"points": [{{"value": 1, "opacity": 0.5, "color": "#Ff0000"}}] {distance}}},
            "shading": {{"lights": [{{"direction": {light}}}]}}}}"##
        ))
    };
    assert_eq!(given("", "[0, 0, 2]"), given(r#", "opacity_distance": 0.5"#, "[0, 0, 1]"));
}

#[test]
fn whatever_changes_the_pixels_changes_the_canonical_text() {
    let different = [
        r#"{}"#,
        r#"{"camera": {"azimuth": 1e-9}}"#,
        r#"{"image": {"width": 511}}"#,
        r#"{"image": {"background": "transparent"}}"#,
        r##"{"image": {"background": "#000001"}}"##,
        r#"{"image": {"stage": "intermediate"}}"#,
        r#"{"shading": false}"#,
        r#"{"shading": {"ambient": 0.3}}"#,
        r#"{"algorithm": "raycast"}"#,
        r#"{"algorithm": "raycast", "sample_distance": 0.4}"#,
        r#"{"early_ray_termination": 1}"#,
        r#"{"algorithm": "classified"}"#,
        r#"{"algorithm": "classified", "min_opacity": 0}"#,
        r#"{"algorithm": "classified", "quality": "draft", "early_ray_termination": 0.99}"#,
        r#"{"algorithm": "fast-classification"}"#,
        r#"{"quality": "high"}"#,
        r#"{"quality": "draft", "early_ray_termination": 0.99}"#,
        r#"{"quality": "high", "preintegration": {"samples_per_voxel": 1}, "early_ray_termination": 0.99}"#,
        r#"{"blend": "maximum"}"#,
        r#"{"blend": "maximum", "quality": "draft"}"#,
        r#"{"blend": "maximum", "preintegration": {"samples_per_voxel": 4}}"#,
        r#"{"blend": "maximum", "algorithm": "raycast"}"#,
        r#"{"blend": "minimum"}"#,
        r#"{"blend": "maximum", "window": {"center": 0, "width": 1}}"#,
        r#"{"depth_cueing": {}}"#,
        r#"{"depth_cueing": {"density": 2}}"#,
        r#"{"clip": [{"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}]}"#,
        r#"{"clip": [{"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}, "keep": "outside"}]}"#,
        r#"{"clip": [{"box": {"min": [-1, -1, -1], "max": [1, 1, 1]}}]}"#,
        r#"{"clip": [{"box": {"min": [-1, -1, -1], "max": [1, 1, 1], "pose": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 9, 1]}}]}"#,
        r#"{"clip": [{"sphere": {"center": [0, 0, 0], "radius": 3}}]}"#,
        r#"{"clip": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "keep": "outside"}]}"#,
        r#"{"clip": [{"hull": {"points": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]}}]}"#,
        r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}}]}"#,
        r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "blend": "maximum"}]}"#,
        r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "opacity": 0.5}]}"#,
        r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "shading": false}]}"#,
        r#"{"level": 1}"#,
        r#"{"level": 1, "algorithm": "raycast"}"#,
        r#"{"preintegration": {"entries": 100}}"#,
        r#"{"preintegration": {"lookup": "nearest"}}"#,
        r#"{"preintegration": {"table": "1d"}}"#,
        r#"{"preintegration": {"opacity_correction": "off"}}"#,
        r#"{"preintegration": {"samples_per_voxel": 2}}"#,
        r##"{"transfer_function": {"points": [{"value": 1, "opacity": 0.5, "color": "#ff0000"}]}}"##,
    ];
    let texts: std::collections::HashSet<_> = different.iter().map(|json| resolve(json).unwrap().canonical()).collect();
    assert_eq!(texts.len(), different.len());
}

#[test]
fn images_over_the_limits_are_refused() {
    assert_eq!(pointer(resolve(r#"{"image": {"width": 100000, "height": 100000}}"#)), "/image/width");
    assert_eq!(pointer(resolve(r#"{"image": {"height": 4097}}"#)), "/image/height");
    let many = resolve(r#"{"image": {"height": 4096, "width": 4096}}"#).unwrap_err();
    assert!(many.to_string().contains("in all"), "{many}");
}

#[test]
fn an_unknown_preset_is_refused_with_the_names_there_are() {
    let refused = resolve(r#"{"transfer_function": "no-such"}"#).unwrap_err().to_string();
    assert!(refused.starts_with("/transfer_function: ") && refused.contains("gray-ramp"), "{refused}");
    let query = RenderRequest::from_query("preset=no-such").unwrap();
    assert_eq!(pointer(query.resolve(&volume(), &FittedPresets::of(&volume(), None), &LIMITS)), "/preset");
}

#[test]
fn drafts_take_the_level_of_their_pixels_and_a_level_may_be_told() {
    let placement = Placement::from_spacing(DVec3::ONE);
    let scalars = Scalars::U8(vec![0; 300 * 300 * 2]);
    let report = ImportReport::plain("test", ScalarType::U8);
    let volume = Volume::new([300, 300, 2], placement, scalars, (1.0, 0.0), report).unwrap();
    let presets = FittedPresets::of(&volume, None);
    let level = |json: &str| {
        let request = RenderRequest::from_json(json.as_bytes()).unwrap();
        request.resolve(&volume, &presets, &LIMITS).map(|resolved| resolved.level())
    };
    // The picture is 423 mm high.
    for (rest, expected) in [
        (r#""image": {"height": 512}"#, 1),
        (r#""image": {"height": 200}"#, 2),
        (r#""image": {"height": 200}, "camera": {"zoom": 4}"#, 1),
        (r#""image": {"height": 20}"#, 3),
        (r#""image": {"height": 20}, "camera": {"projection": "perspective"}"#, 3),
        (r#""image": {"height": 20}, "level": 0"#, 0),
        (r#""image": {"height": 20}, "algorithm": "raycast""#, 0),
    ] {
        assert_eq!(level(&format!(r#"{{"quality": "draft", {rest}}}"#)), Ok(expected), "{rest}");
    }
    assert_eq!(level(r#"{"image": {"height": 20}}"#), Ok(0));
    assert_eq!(level(r#"{"level": 3, "quality": "high"}"#), Ok(3));
    let refused = level(r#"{"level": 4}"#).unwrap_err().to_string();
    assert!(refused.starts_with("/level: expected a level from 0 to 3"), "{refused}");
}

#[test]
fn a_region_is_as_around_but_for_what_it_tells() {
    let sphere = r#""sphere": {"center": [0, 0, 0], "radius": 3}"#;
    let points = r##"[{"value": 1, "opacity": 0.5, "color": "#ff0000"}]"##;
    let resolved = |around: &str, region: &str| {
        let resolved = resolve(&format!(r#"{{{around} "regions": [{{{sphere}{region}}}]}}"#)).unwrap();
        (resolved.look, resolved.regions[0].look.clone().unwrap())
    };
    for around in ["", r#""blend": "minimum", "window": {"center": 3},"#, r#""shading": false, "quality": "high","#] {
        let (around, region) = resolved(around, "");
        assert_eq!(region, around);
    }
    let given = format!(r#""transfer_function": {{"points": {points}}}, "shading": {{"ambient": 0.5}},"#);
    let (around, region) = resolved(&given, r#", "opacity": 0.25"#);
    assert_eq!((around.transfer.points[0].opacity, region.transfer.points[0].opacity), (0.5, 0.125));
    assert_eq!(region.settings, around.settings);
    let (around, region) = resolved(&given, r#", "blend": "maximum", "shading": true"#);
    assert_eq!(around.settings.blend, Blend::Composite);
    assert!(matches!(region.settings.blend, Blend::Projection(IntensityProjection::Maximum, _)));
    assert_eq!(region.settings.shading, Some(Shading::default()));
    let unknown = format!(r#"{{"regions": [{{{sphere}, "transfer_function": "no-such"}}]}}"#);
    assert_eq!(pointer(resolve(&unknown)), "/regions/0/transfer_function");
}

#[test]
fn cameras_without_a_view_are_refused_by_their_field() {
    let look = r#"{"camera": {"look_at": {"position": [0, 0, 9], "target": [0, 0, 0]}}}"#;
    assert_eq!(pointer(resolve(look)), "/camera/look_at");
    let zeros = [0; 16];
    let matrices = format!(r#"{{"camera": {{"matrices": {{"view": {zeros:?}, "projection": {zeros:?}}}}}}}"#);
    assert_eq!(pointer(resolve(&matrices)), "/camera/matrices/view");
}

#[test]
fn a_query_resolves_like_its_json() {
    let json = r##"{"camera": {"azimuth": 30, "fov_y": 40, "projection": "perspective"}, "image": {"width": 64,
        "background": "#102030"}, "transfer_function": "gray-ramp", "shading": false, "quality": "draft"}"##;
    let rest = "azimuth=30.0&fov_y=4e1&projection=perspective&width=64&preset=gray-ramp&shading=false&quality=draft";
    for background in ["102030", "%23102030"] {
        let query = RenderRequest::from_query(&format!("{rest}&background={background}")).unwrap();
        assert_eq!(
            query.resolve(&volume(), &FittedPresets::of(&volume(), None), &LIMITS).unwrap(),
            resolve(json).unwrap()
        );
    }
}
