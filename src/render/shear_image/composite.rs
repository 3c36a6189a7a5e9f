//! Emission and absorption along a packet: slabs between slices, pre-integrated.
//!
//! A slab's scalars are those of its front and back slice; the back ones are the next slab's front
//! ones. Its light comes from the gradient in its middle, asked for only where the slab shows
//! something. Slabs at the two ends of a ray are cut where it enters and leaves the volume: they are
//! sampled there, and their opacity is that of the shorter length.

use std::time::Instant;

use glam::{Mat3, Vec4};

use super::packet::{LANES, Lanes, Packet};
use super::sampler::Sampler;
use super::skip::Skip;
use super::{Frame, Pixels};
use crate::classify::TransferFunction;
use crate::classify::preintegration::{Bilinear, Form, Nearest, Slabs};
use crate::render::lighting::Lighting;
use crate::render::{DepthCueing, Image, Lookup, OpacityCorrection, RenderError, Scene, Timings};
use crate::volume::gradient::{Code, GradientFrame};

/// A frame of emission and absorption.
pub(super) fn frame<T: Code>(
    codes: &[T],
    scene: &Scene<'_>,
    frame: &Frame<'_>,
) -> Result<(Image, Timings), RenderError> {
    let settings = frame.settings;
    let classification = scene.classification.expect("pre-integration needs a classification");
    let tables = classification.slabs().expect("the classification is of slabs");
    let volume = scene.prepared.volume();
    let dims = volume.dims();

    // A table of slabs as long as the view's. Where lengths differ from ray to ray, or extinction
    // with the gradient, it is of optical depths, to be scaled.
    let options = settings.preintegration;
    let steps = options.samples_per_voxel;
    let (view_length, slice_distance) = frame.rays.lengths(volume);
    let (slice_length, same_length) = match options.opacity_correction {
        OpacityCorrection::View => (view_length, frame.rays.is_parallel()),
        OpacityCorrection::Lookup => (slice_distance, false),
        OpacityCorrection::Off => (slice_distance, true),
    };
    let gradient_opacity = Some(scene.transfer).filter(|transfer| !transfer.gradient_opacity.is_empty());
    let scaled = gradient_opacity.is_some() || !same_length;
    let form = if scaled { Form::OpticalDepth } else { Form::Opacity };
    let making = Instant::now();
    let table = tables.table(form, (slice_length / steps as f64) as f32);
    let preintegration_table = making.elapsed();

    let gradient_frame = GradientFrame::new(volume.placement(), volume.rescale().0);
    let lighting = settings.shading.as_ref().map(Lighting::new);
    let walk = Walk {
        sampler: Sampler::new(codes, dims),
        skip: if settings.skipping { Skip::new(dims, classification, scene.encodings) } else { Skip::nothing(dims) },
        steps,
        per_length: if same_length { None } else { Some(1.0 / slice_length as f32) },
        gradient: (gradient_frame.world_from_frame * gradient_frame.frame_from_differences).as_mat3(),
        gradient_opacity,
        lighting: lighting.as_ref(),
        depth_cueing: settings.depth_cueing,
        opaque: settings.early_ray_termination,
    };
    let (image, timings) = match options.lookup {
        Lookup::Nearest => walk.render(frame, Nearest(&table), scaled),
        Lookup::Bilinear => walk.render(frame, Bilinear(&table), scaled),
    }?;
    Ok((image, Timings { preintegration_table, ..timings }))
}

/// How packets walk, whatever the type parameters.
struct Walk<'a, T> {
    sampler: Sampler<'a, T>,
    skip: Skip<'a>,
    /// Slabs from a slice of voxels to the next.
    steps: usize,
    /// One over the length that the table's slabs have from slice to slice, where rays differ; 1 / mm.
    per_length: Option<f32>,
    /// World gradient from differences of codes.
    gradient: Mat3,
    gradient_opacity: Option<&'a TransferFunction>,
    lighting: Option<&'a Lighting>,
    depth_cueing: Option<DepthCueing>,
    /// Accumulated opacity at which a pixel is done.
    opaque: f32,
}

impl<T: Code> Walk<'_, T> {
    /// Chooses the kernel's type parameters.
    fn render<S: Slabs>(&self, frame: &Frame<'_>, table: S, scaled: bool) -> Result<(Image, Timings), RenderError> {
        match (self.lighting.is_some(), scaled) {
            (false, false) => frame.render(&Composite::<T, S, false, false> { walk: self, table }),
            (false, true) => frame.render(&Composite::<T, S, false, true> { walk: self, table }),
            (true, false) => frame.render(&Composite::<T, S, true, false> { walk: self, table }),
            (true, true) => frame.render(&Composite::<T, S, true, true> { walk: self, table }),
        }
    }
}

/// The kernel. `SCALED`: the table holds optical depths.
struct Composite<'a, T, S, const LIT: bool, const SCALED: bool> {
    walk: &'a Walk<'a, T>,
    table: S,
}

/// What a packet has come to.
struct State {
    pixels: [Vec4; LANES],
    /// Lanes that are neither opaque nor outside of the volume, a bit each.
    open: u32,
    /// Positions between which all lanes are inside the volume.
    inside: (f32, f32),
    /// Lengths of rays in units of the table's.
    ratio: Lanes,
    /// Factor on the colour and addend, as last asked for.
    light: [Lanes; 2],
    /// What was added to the pixels since then.
    since: Lanes,
}

/// Light is taken from the slab before until this much of a pixel was made with it: half a step of an 8-bit
/// channel. Gradients are most of a lit frame's cost, and behind much that is translucent they are
/// asked for in vain.
const STALE_LIGHT: f32 = 0.5 / 255.0;

impl State {
    /// The lanes of `shown` whose light must be asked for anew.
    #[inline(always)]
    fn unlit(&mut self, shown: u32, slabs: &[Vec4; LANES]) -> u32 {
        let mut unlit = 0;
        for lane in 0..LANES {
            let since = self.since[lane] + slabs[lane].w * (1.0 - self.pixels[lane].w);
            let stale = since > STALE_LIGHT;
            self.since[lane] = if stale { 0.0 } else { since };
            unlit |= u32::from(stale) << lane;
        }
        unlit & shown
    }
}

impl<T: Code, S: Slabs, const LIT: bool, const SCALED: bool> Pixels for Composite<'_, T, S, LIT, SCALED> {
    #[inline(always)]
    fn pixels(&self, packet: &Packet) -> [Vec4; LANES] {
        let Walk { sampler, skip, steps, .. } = self.walk;
        let open = packet.hits();
        let per_length = self.walk.per_length;
        let ratio = per_length.map_or([1.0; LANES], |per_length| packet.length.map(|length| length * per_length));
        let mut state = State {
            pixels: [Vec4::ZERO; LANES],
            open,
            inside: packet.inside(open),
            ratio,
            light: [[0.0; LANES]; 2],
            since: [f32::INFINITY; LANES],
        };
        let (enter, leave) = packet.span();
        let end = (leave.ceil() as usize).min(sampler.dims()[packet.axis] - 1);
        let step = 1.0 / *steps as f32;
        let mut front = [0.0; LANES];
        let (mut layer, mut reached) = (enter.floor() as usize, usize::MAX);
        while state.open != 0 {
            layer = skip.next_layer(packet, layer, end);
            if layer >= end {
                break;
            }
            if layer != reached {
                front = self.coordinates(sampler.on_slice(packet, layer));
            }
            for n in 1..=*steps {
                let back = self.coordinates(if n == *steps {
                    sampler.on_slice(packet, layer + 1)
                } else {
                    sampler.between(packet, layer, n as f32 * step)
                });
                let from = layer as f32 + (n - 1) as f32 * step;
                self.slabs(packet, &mut state, [from, layer as f32 + n as f32 * step], &front, &back);
                front = back;
            }
            layer += 1;
            reached = layer;
        }
        state.pixels
    }
}

impl<T: Code, S: Slabs, const LIT: bool, const SCALED: bool> Composite<'_, T, S, LIT, SCALED> {
    #[inline(always)]
    fn coordinates(&self, mut codes: Lanes) -> Lanes {
        for code in &mut codes {
            *code = self.table.coordinate(*code);
        }
        codes
    }

    /// The slabs of all lanes between two slice positions.
    #[inline(always)]
    fn slabs(&self, packet: &Packet, state: &mut State, [from, to]: [f32; 2], front: &Lanes, back: &Lanes) {
        if from < state.inside.0 || to > state.inside.1 {
            self.ends(packet, state, [from, to], front, back);
            return;
        }
        let mut slabs = [Vec4::ZERO; LANES];
        for lane in 0..LANES {
            slabs[lane] = self.table.slab(front[lane], back[lane]);
        }
        self.blend(packet, state, &[0.5 * (from + to); LANES], slabs, &[1.0; LANES]);
    }

    /// Slabs some of which are cut by an end of their ray.
    #[inline(never)]
    fn ends(&self, packet: &Packet, state: &mut State, [from, to]: [f32; 2], front: &Lanes, back: &Lanes) {
        let mut slabs = [Vec4::ZERO; LANES];
        let (mut middles, mut shares) = ([from; LANES], [1.0; LANES]);
        for lane in 0..LANES {
            let (enter, leave) = (packet.enter[lane].max(from), packet.leave[lane].min(to));
            if enter >= leave {
                continue;
            }
            let coordinate = |t: f32, whole: f32, on_slice: f32| {
                if t == whole {
                    on_slice
                } else {
                    let sampler = &self.walk.sampler;
                    self.table.coordinate(sampler.scalar(sampler.position(packet, lane, t)))
                }
            };
            slabs[lane] = self.table.slab(coordinate(enter, from, front[lane]), coordinate(leave, to, back[lane]));
            middles[lane] = 0.5 * (enter + leave);
            shares[lane] = (leave - enter) / (to - from);
        }
        self.blend(packet, state, &middles, slabs, &shares);
    }

    /// Puts slabs around slice positions behind their lanes' pixels; `shares` are their lengths in the
    /// table's.
    #[inline(always)]
    fn blend(&self, packet: &Packet, state: &mut State, middles: &Lanes, mut slabs: [Vec4; LANES], shares: &Lanes) {
        // Which lanes show something?
        let mut shown = 0;
        for lane in 0..LANES {
            shown |= u32::from(slabs[lane].w > 0.0) << lane;
        }
        shown &= state.open;
        if shown == 0 {
            return;
        }
        let by_gradient = SCALED && self.walk.gradient_opacity.is_some();
        let asked = if by_gradient {
            shown
        } else if LIT {
            state.unlit(shown, &slabs)
        } else {
            0
        };
        let gradients = if asked != 0 { self.gradients(packet, middles, asked) } else { [[0.0; LANES]; 3] };
        self.scale(state, &gradients, &mut slabs, shares);
        if LIT && let Some(lighting) = self.walk.lighting {
            if asked != 0 {
                let light = lighting.shade(&gradients, &packet.to_eye);
                for lane in 0..LANES {
                    if asked >> lane & 1 == 1 {
                        [state.light[0][lane], state.light[1][lane]] = [light[0][lane], light[1][lane]];
                    }
                }
            }
            for lane in 0..LANES {
                let opacity = Vec4::splat(slabs[lane].w);
                let lit = (slabs[lane] * state.light[0][lane] + opacity * state.light[1][lane]).min(opacity);
                slabs[lane] = lit.with_w(slabs[lane].w);
            }
        }
        if let Some(DepthCueing { front, density }) = self.walk.depth_cueing {
            for lane in 0..LANES {
                let depth = packet.depth[0][lane] + middles[lane] * packet.depth[1][lane];
                let cued = slabs[lane] * (front as f32 * (-(density as f32) * depth).exp());
                slabs[lane] = cued.with_w(slabs[lane].w);
            }
        }
        let mut opaque = 0;
        for lane in 0..LANES {
            let pixel = state.pixels[lane];
            let behind = pixel + slabs[lane] * (1.0 - pixel.w);
            state.pixels[lane] = if shown >> lane & 1 == 1 { behind } else { pixel };
            opaque |= u32::from(behind.w >= self.walk.opaque) << lane;
        }
        state.open &= !(opaque & shown);
    }

    /// World gradients of the lanes that are `shown`, by component.
    #[inline(always)]
    fn gradients(&self, packet: &Packet, middles: &Lanes, mut shown: u32) -> [Lanes; 3] {
        let sampler = &self.walk.sampler;
        let mut gradients = [[0.0; LANES]; 3];
        while shown != 0 {
            let lane = shown.trailing_zeros() as usize % LANES;
            shown &= shown - 1;
            let gradient = self.walk.gradient * sampler.differences(sampler.position(packet, lane, middles[lane]));
            [gradients[0][lane], gradients[1][lane], gradients[2][lane]] = gradient.to_array();
        }
        gradients
    }

    /// Makes opacities of what was looked up for the lengths and gradients that slabs really have.
    #[inline(always)]
    fn scale(&self, state: &State, gradients: &[Lanes; 3], slabs: &mut [Vec4; LANES], shares: &Lanes) {
        if SCALED {
            for lane in 0..LANES {
                let mut scale = state.ratio[lane] * shares[lane];
                if let Some(transfer) = self.walk.gradient_opacity {
                    let [x, y, z] = [gradients[0][lane], gradients[1][lane], gradients[2][lane]];
                    let magnitude = (x * x + y * y + z * z).sqrt();
                    scale *= transfer.gradient_factor(f64::from(magnitude)) as f32;
                }
                let depth = slabs[lane].w;
                let opacity = opacity(depth * scale);
                let color = if depth > 0.0 { opacity / depth } else { 0.0 };
                slabs[lane] = (slabs[lane] * color).with_w(opacity);
            }
        } else {
            for lane in 0..LANES {
                let whole = slabs[lane].w;
                if shares[lane] != 1.0 && whole > 0.0 {
                    let opacity = 1.0 - (1.0 - whole).powf(shares[lane]);
                    slabs[lane] = (slabs[lane] * (opacity / whole)).with_w(opacity);
                }
            }
        }
    }
}

/// Opacity of an optical depth.
#[inline(always)]
fn opacity(depth: f32) -> f32 {
    1.0 - (-depth).exp()
}
