//! Transfer functions: control points -> extinction and colour.
//!
//! Opacity and colour are piecewise linear between their points and constant outside them. An
//! opacity `a` is meant for a reference length (`opacity_distance`, mm); what a medium has is the
//! extinction `tau = -ln(1 - a) / opacity_distance` per mm, from which the opacity over any other
//! length follows: `1 - exp(-tau * length)` (Lacroute and Levoy 1994, section 3.1; Schulze et al.
//! 2003, opacity correction).

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// Opacities count as at most this: an opaque point would have infinite extinction.
pub const MAX_OPACITY: f64 = 1.0 - 1e-7;

/// A display-referred sRGB colour, each channel 0..=1. Written as `"#rrggbb"`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Color(pub [f32; 3]);

impl Color {
    /// Reads `#rrggbb`.
    pub fn from_hex(text: &str) -> Option<Self> {
        let digits = text.strip_prefix('#').filter(|d| d.len() == 6 && d.bytes().all(|b| b.is_ascii_hexdigit()))?;
        let value = u32::from_str_radix(digits, 16).ok()?;
        Some(Self([16, 8, 0].map(|shift| ((value >> shift) & 255) as f32 / 255.0)))
    }

    /// Writes `#rrggbb`.
    pub fn to_hex(self) -> String {
        let [r, g, b] = self.0.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8);
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}

impl<'de> Deserialize<'de> for Color {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        Self::from_hex(&text)
            .ok_or_else(|| de::Error::custom(format!("expected a colour like \"#rrggbb\", got {text:?}")))
    }
}

impl Serialize for Color {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.to_hex())
    }
}

/// Opacity and colour at a scalar value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlPoint {
    /// Scalar in the file's own units.
    pub value: f64,
    /// 0..=1 for the reference length.
    pub opacity: f64,
    pub color: Color,
}

/// A factor on the extinction at a gradient magnitude.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GradientPoint {
    /// |grad s| in scalar units per mm.
    pub value: f64,
    /// 0..=1; multiplies the extinction.
    pub opacity: f64,
}

/// Why numbers do not make a transfer function: the field as a JSON pointer, and what was wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InvalidField {
    /// JSON pointer below the transfer function, such as `/points/2/value`.
    pub pointer: String,
    pub detail: String,
}

/// Opacity and colour over scalars, as a client writes it; [`TransferFunction::validate`] checks it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransferFunction {
    /// In ascending order of value; two points at one value make a step.
    pub points: Vec<ControlPoint>,
    /// The length in mm that opacities are meant for; unless told, the smallest spacing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub opacity_distance: Option<f64>,
    /// In ascending order of value; empty: no dependence on the gradient.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gradient_opacity: Vec<GradientPoint>,
}

impl TransferFunction {
    /// Control points at most, of either kind.
    pub const MAX_POINTS: usize = 1024;

    /// Every field that is out of range; empty where the transfer function is sound.
    pub fn validate(&self) -> Vec<InvalidField> {
        let mut invalid = Vec::new();
        let mut refuse = |pointer: String, detail: String| invalid.push(InvalidField { pointer, detail });
        if self.points.is_empty() || self.points.len() > Self::MAX_POINTS {
            refuse("/points".into(), format!("expected 1 to {} points, got {}", Self::MAX_POINTS, self.points.len()));
        }
        if self.gradient_opacity.len() > Self::MAX_POINTS {
            let got = self.gradient_opacity.len();
            refuse("/gradient_opacity".into(), format!("expected at most {} points, got {got}", Self::MAX_POINTS));
        }
        let scalar = self.points.iter().map(|p| ("points", p.value, p.opacity));
        let gradient = self.gradient_opacity.iter().map(|p| ("gradient_opacity", p.value, p.opacity));
        let mut previous: Option<(&str, f64)> = None;
        let mut index = 0;
        for (list, value, opacity) in scalar.chain(gradient) {
            index = if previous.is_some_and(|(l, _)| l == list) { index + 1 } else { 0 };
            if !value.is_finite() {
                refuse(format!("/{list}/{index}/value"), "expected a finite number".into());
            }
            if !(0.0..=1.0).contains(&opacity) {
                refuse(format!("/{list}/{index}/opacity"), format!("expected 0 to 1, got {opacity}"));
            }
            if let Some((_, before)) = previous.filter(|(l, before)| *l == list && value < *before) {
                refuse(
                    format!("/{list}/{index}/value"),
                    format!("expected ascending values, got {value} after {before}"),
                );
            }
            previous = Some((list, value));
        }
        if let Some(distance) = self.opacity_distance.filter(|d| !(d.is_finite() && *d > 0.0)) {
            refuse("/opacity_distance".into(), format!("expected a length above 0 mm, got {distance}"));
        }
        invalid
    }

    /// Opacity at a scalar value, for the reference length.
    pub fn opacity(&self, value: f64) -> f64 {
        let (low, high, t) = bracket(&self.points, value, |p| p.value);
        lerp(low.opacity, high.opacity, t).min(MAX_OPACITY)
    }

    /// Colour at a scalar value.
    pub fn color(&self, value: f64) -> [f64; 3] {
        let (low, high, t) = bracket(&self.points, value, |p| p.value);
        std::array::from_fn(|c| lerp(f64::from(low.color.0[c]), f64::from(high.color.0[c]), t))
    }

    /// Factor on the extinction at a gradient magnitude; 1 where none was asked for.
    pub fn gradient_factor(&self, magnitude: f64) -> f64 {
        if self.gradient_opacity.is_empty() {
            return 1.0;
        }
        let (low, high, t) = bracket(&self.gradient_opacity, magnitude, |p| p.value);
        lerp(low.opacity, high.opacity, t)
    }

    /// The same just below a gradient magnitude: another factor where there is a step.
    pub fn gradient_factor_below(&self, magnitude: f64) -> f64 {
        let first = self.gradient_opacity.iter().find(|point| point.value >= magnitude);
        match first.filter(|point| point.value == magnitude) {
            Some(point) => point.opacity,
            None => self.gradient_factor(magnitude),
        }
    }

    /// True where everything in these ranges of scalar and gradient magnitude has opacity zero.
    /// Piecewise linear functions are zero over a range if they are at its ends and at every point
    /// inside.
    pub fn is_transparent(&self, values: (f64, f64), gradients: (f64, f64)) -> bool {
        let inside = |value: f64, (low, high): (f64, f64)| low <= value && value <= high;
        let by_value = self.opacity(values.0) <= 0.0
            && self.opacity(values.1) <= 0.0
            && self.points.iter().all(|p| p.opacity <= 0.0 || !inside(p.value, values));
        let by_gradient = self.gradient_factor(gradients.0) <= 0.0
            && self.gradient_factor(gradients.1) <= 0.0
            && self.gradient_opacity.iter().all(|p| p.opacity <= 0.0 || !inside(p.value, gradients));
        by_value || by_gradient
    }

    /// The reference length in mm, given the volume's smallest spacing.
    pub fn reference_length(&self, smallest_spacing: f64) -> f64 {
        self.opacity_distance.unwrap_or(smallest_spacing)
    }
}

/// Extinction per mm of an opacity over `length` mm.
pub fn extinction(opacity: f64, length: f64) -> f64 {
    -(-opacity.min(MAX_OPACITY)).ln_1p() / length
}

fn lerp(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// The two points around `value` and where it lies between them (0..=1). At a step, the upper side.
fn bracket<P>(points: &[P], value: f64, key: impl Fn(&P) -> f64) -> (&P, &P, f64) {
    let above = points.partition_point(|p| key(p) <= value);
    if above == 0 {
        return (&points[0], &points[0], 0.0);
    }
    let low = &points[above - 1];
    let Some(high) = points.get(above) else { return (low, low, 0.0) };
    (low, high, (value - key(low)) / (key(high) - key(low)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> TransferFunction {
        let point = |value, opacity, c| ControlPoint { value, opacity, color: Color([c; 3]) };
        TransferFunction {
            points: vec![point(0.0, 0.0, 0.0), point(10.0, 0.5, 1.0)],
            opacity_distance: None,
            gradient_opacity: vec![],
        }
    }

    #[test]
    fn between_points_it_is_linear_and_outside_constant() {
        let tf = ramp();
        assert_eq!(tf.opacity(5.0), 0.25);
        assert_eq!(tf.opacity(-5.0), 0.0);
        assert_eq!(tf.opacity(50.0), 0.5);
        assert_eq!(tf.color(2.5), [0.25; 3]);
    }

    #[test]
    fn an_opaque_point_has_finite_extinction() {
        assert!(extinction(1.0, 1.0).is_finite());
        assert!((extinction(0.5, 2.0) - 2f64.ln() / 2.0).abs() < 1e-12);
    }

    #[test]
    fn wrong_numbers_are_named_by_their_pointer() {
        let mut tf = ramp();
        tf.points[1].value = -1.0;
        tf.points[0].opacity = f64::NAN;
        let pointers: Vec<_> = tf.validate().into_iter().map(|i| i.pointer).collect();
        assert_eq!(pointers, ["/points/0/opacity", "/points/1/value"]);
    }

    #[test]
    fn colours_are_read_as_hex_and_nothing_else() {
        assert_eq!(Color::from_hex("#ff8000").unwrap().to_hex(), "#ff8000");
        for bad in ["ff8000", "#ff80", "#gg0000", "#+f8000", "red"] {
            assert!(Color::from_hex(bad).is_none(), "{bad}");
        }
    }
}
