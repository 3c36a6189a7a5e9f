//! Emission and absorption along a packet: slabs between slices, pre-integrated.
//!
//! The packets of a tile pass a layer of cells together, so that its voxels are made ready once
//! ([`Patch`]); each of them passes over the layers in which it sees nothing. A slab's scalars are
//! those of its front and back slice; the back ones are the next slab's front ones. Its light comes
//! from the gradient in its middle, asked for only where the slab shows something. Slabs at the two ends
//! of a ray are cut where it enters and leaves the volume: they are sampled there, and their opacity is
//! that of the shorter length.

use std::time::Instant;

use glam::{Mat3, Vec3, Vec4};

use super::medium::{Medium, Scalars};
use super::packet::{IN_SLICE, Packet};
use super::painted::{Looks, Painted};
use super::patch::{Cells, Patch, Slice};
use super::sampler::Sampler;
use super::skip::Skip;
use super::{Frame, Pixels};
use crate::classify::TransferFunction;
use crate::classify::preintegration::{Bilinear, Form, Nearest, OneDimensional};
use crate::render::lighting::Lighting;
use crate::render::shadow::darken;
use crate::render::{DepthCueing, Lookup, OpacityCorrection, RenderError, Scene, SlabTable, Timings};
use crate::simd::numbers::{Numbers, exp};
use crate::simd::wide::{LANES, Lanes, Portable, Wide, rows};
use crate::volume::gradient::{Code, GradientFrame};
use crate::volume::scanlines::Scanlines;

/// A frame of emission and absorption.
pub(super) fn frame<T: Code>(
    codes: &[T],
    scanlines: [Scanlines<'_, T>; 3],
    scene: &Scene<'_>,
    frame: &Frame<'_>,
) -> Result<(Vec<Vec4>, Timings), RenderError> {
    let settings = frame.settings;
    let classification = scene.classification.expect("pre-integration needs a classification");
    let looks = Looks::of(codes, scene, classification.tables(), settings.sampling);
    let volume = scene.prepared.volume();
    let dims = volume.dims();

    // A table of slabs as long as the view's. Where lengths differ from ray to ray, or extinction
    // with the gradient, it is of optical depths, to be scaled.
    let options = settings.preintegration;
    // At a joint rays pass the layers of either part at their flattest, up to 1.7 voxels from slice to slice,
    // and sample the cells in other places on one side than on the other.
    let steps = options.samples_per_voxel + usize::from(frame.rays.has_joints());
    let (view_length, slice_distance) = frame.rays.lengths(volume);
    let (slice_length, same_length) = match options.opacity_correction {
        OpacityCorrection::View => (view_length, frame.rays.is_parallel()),
        OpacityCorrection::Lookup => (slice_distance, false),
        OpacityCorrection::Off => (slice_distance, true),
    };
    let gradient_opacity = Some(scene.transfer).filter(|transfer| !transfer.gradient_opacity.is_empty());
    let scaled = gradient_opacity.is_some() || !same_length || looks.is_some();
    let form = if scaled { Form::OpticalDepth } else { Form::Opacity };
    let gradient_frame = GradientFrame::new(volume.placement(), volume.rescale().0);
    let lighting = |transmittance| settings.shading.as_ref().map(|shading| Lighting::new(shading, transmittance));
    let (lighting, in_shadow) = (lighting(1.0), scene.shadow.and_then(|_| lighting(0.0)));
    let walk = Walk {
        sampler: Sampler::new(codes, dims),
        scanlines,
        skip: if settings.skipping { Skip::new(dims, classification, scene.encodings) } else { Skip::nothing(dims) },
        steps,
        // Slabs of looks are as deep as they would be over 1 mm.
        per_length: match &looks {
            Some(_) => Some(1.0 / steps as f32),
            None => (!same_length).then(|| 1.0 / slice_length as f32),
        },
        gradient: (gradient_frame.world_from_frame * gradient_frame.frame_from_differences).as_mat3(),
        // Labels have gradient opacities of their own.
        gradient_opacity: gradient_opacity.filter(|_| scene.labels.is_none()),
        by_gradient: gradient_opacity.is_some(),
        lighting: lighting.as_ref(),
        shadow: in_shadow.as_ref().zip(scene.shadow.map(|shadow| Sampler::new(shadow.lacking(), dims))),
        depth_cueing: settings.depth_cueing,
        opaque: settings.early_ray_termination,
    };
    if let Some(looks) = &looks {
        return walk.render(
            frame,
            Painted { looks, by_gradient: gradient_opacity.is_some() && scene.labels.is_some() },
            scaled,
        );
    }
    let tables = classification.slabs().expect("the classification is of slabs");
    let making = Instant::now();
    let slab_length = (slice_length / steps as f64) as f32;
    let (image, timings, preintegration_table) = match options.table {
        SlabTable::OneDimensional => {
            let sums = tables.running_sums(form, slab_length);
            let made = making.elapsed();
            let (image, timings) = walk.render(frame, Scalars(OneDimensional(&sums)), scaled)?;
            (image, timings, made)
        }
        SlabTable::TwoDimensional => {
            let table = tables.table(form, slab_length);
            let made = making.elapsed();
            let (image, timings) = match options.lookup {
                Lookup::Nearest => walk.render(frame, Scalars(Nearest(&table)), scaled),
                Lookup::Bilinear => walk.render(frame, Scalars(Bilinear(&table)), scaled),
            }?;
            (image, timings, made)
        }
    };
    Ok((image, Timings { preintegration_table, ..timings }))
}

/// How packets walk, whatever the type parameters.
struct Walk<'a, T> {
    /// For the ends of rays, which are on no slice.
    sampler: Sampler<'a, T>,
    /// By principal axis.
    scanlines: [Scanlines<'a, T>; 3],
    skip: Skip<'a>,
    /// Slabs from a slice of voxels to the next.
    steps: usize,
    /// One over the length that the table's slabs have from slice to slice, where rays differ; 1 / mm.
    per_length: Option<f32>,
    /// World gradient from differences of codes.
    gradient: Mat3,
    gradient_opacity: Option<&'a TransferFunction>,
    /// Extinction depends on the gradient, by that or otherwise.
    by_gradient: bool,
    lighting: Option<&'a Lighting>,
    /// The light where the one that casts shadows is gone, and how much of that each voxel lacks, in 255ths.
    shadow: Option<(&'a Lighting, Sampler<'a, u8>)>,
    depth_cueing: Option<DepthCueing>,
    /// Accumulated opacity at which a pixel is done.
    opaque: f32,
}

impl<T: Code> Walk<'_, T> {
    /// Chooses the kernel's type parameters.
    fn render<M: Medium<T>>(
        &self,
        frame: &Frame<'_>,
        medium: M,
        scaled: bool,
    ) -> Result<(Vec<Vec4>, Timings), RenderError> {
        match (self.lighting.is_some(), scaled) {
            (false, false) => frame.render(&Composite::<T, M, false, false> { walk: self, medium }),
            (false, true) => frame.render(&Composite::<T, M, false, true> { walk: self, medium }),
            (true, false) => frame.render(&Composite::<T, M, true, false> { walk: self, medium }),
            (true, true) => frame.render(&Composite::<T, M, true, true> { walk: self, medium }),
        }
    }
}

/// Cells of a layer under a tile at most, where it has more than one packet: what stays in the first-level cache.
const TILE_CELLS: usize = 256;

/// The kernel. `SCALED`: slabs are told by optical depths.
struct Composite<'a, T, M, const LIT: bool, const SCALED: bool> {
    walk: &'a Walk<'a, T>,
    medium: M,
}

/// What a job keeps from tile to tile.
struct Buffers<L, S> {
    patch: Patch,
    layer: L,
    states: Vec<State<S>>,
}

impl<L: Default, S> Default for Buffers<L, S> {
    fn default() -> Self {
        Self { patch: Patch::default(), layer: L::default(), states: vec![] }
    }
}

/// What a packet has come to; `S` is what it samples.
struct State<S> {
    /// By channel, premultiplied, opacity last.
    pixels: [Lanes; 4],
    /// 1 for rays that are neither opaque nor outside of the volume, else 0.
    open: Lanes,
    /// Positions between which all lanes are inside the volume.
    inside: (f32, f32),
    /// Lengths of rays in units of the table's.
    ratio: Lanes,
    /// Factor on the colour and addend, as last asked for.
    light: [Lanes; 2],
    /// What was added to the pixels since then.
    since: Lanes,
    /// Something showed in this layer.
    shows: bool,
    /// What was sampled where the last slab began, and where it ended.
    front: S,
    back: S,
    /// The layer that it ended at.
    reached: usize,
    /// The next layer in which something may show, if there is one.
    next: Option<usize>,
    /// Where layers end.
    end: usize,
    /// The cells of the next layer that the packet touches.
    cells: Cells,
}

/// Light is taken from the slab before until this much of a pixel was made with it: half a step of an 8-bit
/// channel. Gradients are most of a lit frame's cost, and behind much that is translucent they are
/// asked for in vain.
const STALE_LIGHT: f32 = 0.5 / 255.0;

/// Where slabs have their middles: all of them within a layer, or each where its ray is cut.
#[derive(Clone, Copy)]
pub(super) enum Middles<'a> {
    Slice { t: f32, fraction: f32 },
    Rays(&'a Lanes),
}

impl Middles<'_> {
    /// A lane's.
    #[inline(always)]
    pub fn of(&self, lane: usize) -> f32 {
        match *self {
            Self::Slice { t, .. } => t,
            Self::Rays(middles) => middles[lane],
        }
    }
}

impl<S> State<S> {
    /// Lanes whose light must be asked for anew (1, else 0), of those that show so much of their slabs.
    #[inline(always)]
    fn unlit<V: Numbers<Memory = Lanes>>(&mut self, shown: V) -> V {
        let (zero, one) = (V::all(0.0), V::all(1.0));
        let since = V::load(&self.since) + shown * (one - V::load(&self.pixels[3]));
        let asked = since.where_above(STALE_LIGHT, shown, zero);
        self.since = asked.where_above(0.0, zero, since).store();
        asked.where_above(0.0, one, zero)
    }
}

impl<T: Code, M: Medium<T>, const LIT: bool, const SCALED: bool> Pixels for Composite<'_, T, M, LIT, SCALED> {
    type Buffers = Buffers<M::Layer, M::Samples>;

    #[inline(always)]
    fn pixels<W: Wide>(&self, tile: &[Packet], buffers: &mut Self::Buffers, out: &mut [[Vec4; LANES]]) {
        let mut rows = tile.len();
        while rows > 1 && self.cells(&tile[..rows]) > TILE_CELLS {
            rows = rows.div_ceil(2);
        }
        for (packets, out) in tile.chunks(rows.max(1)).zip(out.chunks_mut(rows.max(1))) {
            self.tile::<W>(packets, buffers);
            for (state, out) in buffers.states.iter().zip(out) {
                *out = W::columns(&state.pixels);
            }
        }
    }
}

impl<T: Code, M: Medium<T>, const LIT: bool, const SCALED: bool> Composite<'_, T, M, LIT, SCALED> {
    /// Cells of a layer that a tile lies over, at its first or its last slice.
    fn cells(&self, packets: &[Packet]) -> usize {
        let dims = self.walk.sampler.dims();
        let last = (dims[packets[0].axis] - 1) as f32;
        let at = |t: f32| {
            let ends = [&packets[0], &packets[packets.len() - 1]];
            let [a, b] = ends.map(|packet| Cells::touched(packet, [t, t], dims));
            a.with(b).count()
        };
        let spans = [0, packets.len() - 1].map(|n| packets[n].span());
        at(spans[0].0.min(spans[1].0).max(0.0)).max(at(spans[0].1.max(spans[1].1).min(last)))
    }

    /// Before the first slice.
    #[inline(always)]
    fn start<W: Wide>(&self, packet: &Packet) -> State<M::Samples> {
        let dims = self.walk.sampler.dims();
        let hits = packet.hits();
        let mut open = [0.0; LANES];
        for lane in 0..LANES {
            open[lane] = if hits >> lane & 1 == 1 { 1.0 } else { 0.0 };
        }
        let per_length = self.walk.per_length;
        let (enter, leave) = packet.span();
        let end = (leave.ceil() as usize).min(dims[packet.axis] - 1);
        let mut state = State {
            pixels: [[0.0; LANES]; 4],
            open,
            inside: packet.inside(hits),
            ratio: per_length.map_or([1.0; LANES], |per_length| packet.length.map(|length| length * per_length)),
            light: [[0.0; LANES]; 2],
            since: [f32::INFINITY; LANES],
            shows: false,
            front: M::NOTHING,
            back: M::NOTHING,
            reached: usize::MAX,
            next: None,
            end,
            cells: Cells { first: [0; 2], last: [0; 2] },
        };
        self.go_on::<W>(packet, &mut state, enter.floor() as usize);
        state
    }

    /// Finds the next layer from `layer` on.
    #[inline(always)]
    fn go_on<W: Wide>(&self, packet: &Packet, state: &mut State<M::Samples>, layer: usize) {
        let next = self.walk.skip.next_layer::<W>(packet, layer, state.end);
        if next < state.end {
            self.enter(packet, state, next);
        } else {
            state.next = None;
        }
    }

    /// Makes a layer the next one.
    #[inline(always)]
    fn enter(&self, packet: &Packet, state: &mut State<M::Samples>, layer: usize) {
        state.next = Some(layer);
        state.cells = Cells::touched(packet, [layer as f32, (layer + 1) as f32], self.walk.sampler.dims());
    }

    /// Takes the packets of a tile through the volume.
    #[inline(always)]
    fn tile<W: Wide>(
        &self,
        packets: &[Packet],
        Buffers { patch, layer: looks, states }: &mut Buffers<M::Layer, M::Samples>,
    ) {
        let Walk { scanlines, steps, .. } = self.walk;
        let dims = self.walk.sampler.dims();
        states.clear();
        for packet in packets {
            let state = self.start::<W>(packet);
            states.push(state);
        }
        let Packet { axis, reversed, .. } = packets[0];
        let [i, j] = IN_SLICE[axis];
        let dims = [dims[i], dims[j], dims[axis]];
        let step = 1.0 / *steps as f32;
        loop {
            // The next layer of any packet, and all cells of it that are looked at.
            let mut ahead: Option<(usize, Cells)> = None;
            for state in states.iter() {
                let Some(next) = state.next else { continue };
                ahead = match ahead {
                    Some((layer, cells)) if layer == next => Some((layer, cells.with(state.cells))),
                    Some((layer, cells)) if layer < next => Some((layer, cells)),
                    _ => Some((next, state.cells)),
                };
            }
            let Some((layer, cells)) = ahead else { return };
            patch.enter(&scanlines[axis], dims, cells, layer, reversed);
            self.medium.enter(patch, &packets[0], layer, looks);
            for n in 1..=*steps {
                let back = if n == *steps {
                    Slice::Far
                } else {
                    self.medium.interpolate(patch, looks, n as f32 * step);
                    Slice::Between
                };
                let from = layer as f32 + (n - 1) as f32 * step;
                let to = layer as f32 + n as f32 * step;
                let fraction = (n as f32 - 0.5) * step;
                // First what all packets sample: their steps do not wait for each other.
                for (packet, state) in packets.iter().zip(states.iter_mut()) {
                    if state.next != Some(layer) {
                        continue;
                    }
                    state.shows &= n > 1;
                    state.front = if n > 1 || state.reached == layer {
                        state.back
                    } else {
                        let places = patch.places::<W>(packet, &state.cells, layer as f32);
                        self.medium.samples::<W>(patch, looks, Slice::Near, &places)
                    };
                    let places = patch.places::<W>(packet, &state.cells, to);
                    state.back = self.medium.samples::<W>(patch, looks, back, &places);
                }
                for (packet, state) in packets.iter().zip(states.iter_mut()) {
                    if state.next == Some(layer) {
                        self.slabs::<W>(packet, state, patch, [from, to], fraction);
                    }
                }
            }
            for (packet, state) in packets.iter().zip(states.iter_mut()) {
                if state.next == Some(layer) {
                    state.reached = layer + 1;
                    state.next = None;
                    if W::Numbers::load(&state.open).any() {
                        // Behind what shows there is mostly more.
                        let next = layer + 1;
                        if state.shows && next < state.end {
                            self.enter(packet, state, next)
                        } else {
                            self.go_on::<W>(packet, state, next)
                        }
                    }
                }
            }
        }
    }

    /// The slabs of all lanes between two slice positions of a layer, with their middles a `fraction` of
    /// the way through it.
    #[inline(always)]
    fn slabs<W: Wide>(
        &self,
        packet: &Packet,
        state: &mut State<M::Samples>,
        patch: &mut Patch,
        [from, to]: [f32; 2],
        fraction: f32,
    ) {
        if from < state.inside.0 || to > state.inside.1 {
            self.ends(packet, state, patch, [from, to]);
            return;
        }
        let middles = Middles::Slice { t: 0.5 * (from + to), fraction };
        let slabs = self.medium.slabs::<W>(&state.front, &state.back);
        self.blend::<W>(packet, state, patch, middles, slabs, &[1.0; LANES]);
    }

    /// Slabs some of which are cut by an end of their ray.
    #[inline(never)]
    fn ends(&self, packet: &Packet, state: &mut State<M::Samples>, patch: &mut Patch, [from, to]: [f32; 2]) {
        let mut slabs = [Vec4::ZERO; LANES];
        let (mut middles, mut shares) = ([from; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            let (enter, leave) = (packet.enter[lane].max(from), packet.leave[lane].min(to));
            if enter >= leave {
                continue;
            }
            let sample = |t: f32, whole: f32, on_slice: &M::Samples| {
                if t == whole { M::sample(on_slice, lane) } else { self.medium.at(&self.walk.sampler, packet, lane, t) }
            };
            slabs[lane] = self.medium.slab(sample(enter, from, &state.front), sample(leave, to, &state.back));
            middles[lane] = 0.5 * (enter + leave);
            shares[lane] = (leave - enter) / (to - from);
        }
        // Not in wide registers: this is compiled by itself.
        self.blend::<Portable>(packet, state, patch, Middles::Rays(&middles), rows(&slabs), &shares);
    }

    /// Puts slabs, by component, behind their lanes' pixels; `shares` are their lengths in the table's.
    #[inline(always)]
    fn blend<W: Wide>(
        &self,
        packet: &Packet,
        state: &mut State<M::Samples>,
        patch: &mut Patch,
        middles: Middles<'_>,
        [red, green, blue, opacity]: [Lanes; 4],
        shares: &Lanes,
    ) {
        let mut opacity = W::Numbers::load(&opacity);
        let (zero, one) = (W::Numbers::all(0.0), W::Numbers::all(1.0));
        let open = W::Numbers::load(&state.open);
        // Does any lane show something?
        let shown = opacity * open;
        if !shown.any() {
            return;
        }
        state.shows = true;
        let by_gradient = SCALED && self.walk.by_gradient;
        let unlit = if LIT && !by_gradient { state.unlit(shown) } else { one };
        let asked = (LIT || by_gradient) && unlit.any();
        let gradients = if asked { self.gradients::<W>(packet, state, patch, middles) } else { [zero; 3] };
        let mut colors = [W::Numbers::load(&red), W::Numbers::load(&green), W::Numbers::load(&blue)];
        if by_gradient
            && let Some(slabs) =
                self.medium.with_gradients(&self.walk.sampler, packet, middles, &length::<W>(gradients).store())
        {
            let [red, green, blue, depth] = slabs.map(|slab| W::Numbers::load(&slab));
            (colors, opacity) = ([red, green, blue], depth);
        }
        if SCALED || matches!(middles, Middles::Rays(_)) {
            let ratios = self.scale::<W>(state, gradients, &mut opacity, shares);
            for color in &mut colors {
                *color = *color * ratios;
            }
        }
        if LIT && let Some(lighting) = self.walk.lighting {
            if asked {
                let [x, y, z] = &packet.to_eye;
                let to_eye = [W::Numbers::load(x), W::Numbers::load(y), W::Numbers::load(z)];
                let [mut factors, mut addends] = lighting.shade(gradients, to_eye);
                if let Some((in_shadow, lacking)) = &self.walk.shadow {
                    let [dark_factors, dark_addends] = in_shadow.shade(gradients, to_eye);
                    let mut light = [factors.store(), addends.store()];
                    let in_shadow = [dark_factors.store(), dark_addends.store()];
                    darken(&mut light, &in_shadow, lacking_at(lacking, packet, middles));
                    (factors, addends) = (W::Numbers::load(&light[0]), W::Numbers::load(&light[1]));
                }
                let [kept_factors, kept_addends] = &mut state.light;
                *kept_factors = unlit.where_above(0.0, factors, W::Numbers::load(kept_factors)).store();
                *kept_addends = unlit.where_above(0.0, addends, W::Numbers::load(kept_addends)).store();
            }
            let (factors, addends) = (W::Numbers::load(&state.light[0]), W::Numbers::load(&state.light[1]));
            let highlights = opacity * addends;
            for color in &mut colors {
                *color = (*color * factors + highlights).least(opacity);
            }
        }
        if let Some(DepthCueing { front, density }) = self.walk.depth_cueing {
            let mut cue = [0.0; LANES];
            for lane in 0..LANES {
                cue[lane] = -(density as f32) * (packet.depth[0][lane] + middles.of(lane) * packet.depth[1][lane]);
            }
            let cue = W::Numbers::all(front as f32) * exp(W::Numbers::load(&cue));
            for color in &mut colors {
                *color = *color * cue;
            }
        }
        let seen = (one - W::Numbers::load(&state.pixels[3])) * open;
        let slabs = [colors[0], colors[1], colors[2], opacity];
        for n in 0..slabs.len() {
            state.pixels[n] = (W::Numbers::load(&state.pixels[n]) + slabs[n] * seen).store();
        }
        state.open = W::keep_below(&state.pixels[3], self.walk.opaque, &state.open);
    }

    /// World gradients, by component.
    #[inline(always)]
    fn gradients<W: Wide>(
        &self,
        packet: &Packet,
        state: &State<M::Samples>,
        patch: &mut Patch,
        middles: Middles<'_>,
    ) -> [W::Numbers; 3] {
        let [i, j] = IN_SLICE[packet.axis];
        let columns = [self.walk.gradient.col(i), self.walk.gradient.col(j), self.walk.gradient.col(packet.axis)];
        match middles {
            Middles::Slice { t, fraction } => {
                patch.differentiate::<W>(fraction);
                let places = patch.places::<W>(packet, &state.cells, t);
                let sign = if packet.reversed { -1.0 } else { 1.0 };
                world::<W>([columns[0], columns[1], columns[2] * sign], &patch.gradients::<W>(&places))
            }
            Middles::Rays(middles) => {
                let sampler = &self.walk.sampler;
                let mut differences = [[0.0; LANES]; 3];
                for lane in 0..LANES {
                    let along = sampler.differences(sampler.position(packet, lane, middles[lane]));
                    for (n, axis) in [i, j, packet.axis].into_iter().enumerate() {
                        differences[n][lane] = along[axis];
                    }
                }
                world::<W>(columns, &differences)
            }
        }
    }

    /// Makes opacities of what was looked up for the lengths and gradients that slabs really have, and gives
    /// the factors on their colours.
    #[inline(always)]
    fn scale<W: Wide>(
        &self,
        state: &State<M::Samples>,
        gradients: [W::Numbers; 3],
        looked_up: &mut W::Numbers,
        shares: &Lanes,
    ) -> W::Numbers {
        let (zero, one) = (W::Numbers::all(0.0), W::Numbers::all(1.0));
        if SCALED {
            let depth = *looked_up;
            let mut scaled = (zero - depth) * (W::Numbers::load(&state.ratio) * W::Numbers::load(shares));
            if let Some(transfer) = self.walk.gradient_opacity {
                let mut factors = length::<W>(gradients).store();
                for factor in &mut factors {
                    *factor = transfer.gradient_factor(f64::from(*factor)) as f32;
                }
                scaled = scaled * W::Numbers::load(&factors);
            }
            *looked_up = one - exp(scaled);
            return depth.where_above(0.0, *looked_up / depth, zero);
        }
        let (mut opacity, mut ratios) = (looked_up.store(), [1.0; LANES]);
        for lane in 0..LANES {
            let whole = opacity[lane];
            if shares[lane] != 1.0 && whole > 0.0 {
                opacity[lane] = 1.0 - (1.0 - whole).powf(shares[lane]);
                ratios[lane] = opacity[lane] / whole;
            }
        }
        *looked_up = W::Numbers::load(&opacity);
        W::Numbers::load(&ratios)
    }
}

/// How much of the light that casts shadows the middles of slabs lack.
#[inline(never)]
fn lacking_at(lacking: &Sampler<'_, u8>, packet: &Packet, middles: Middles<'_>) -> Lanes {
    let mut parts = [0.0; LANES];
    for lane in 0..LANES {
        parts[lane] = lacking.scalar(lacking.position(packet, lane, middles.of(lane))) / 255.0;
    }
    parts
}

/// Lengths of vectors, told by component.
#[inline(always)]
fn length<W: Wide>([x, y, z]: [W::Numbers; 3]) -> W::Numbers {
    (x * x + y * y + z * z).sqrt()
}

/// World gradients from differences along three axes, whose world gradients for a unit are `columns`.
#[inline(always)]
fn world<W: Wide>([a, b, c]: [Vec3; 3], [x, y, z]: &[Lanes; 3]) -> [W::Numbers; 3] {
    let (x, y, z) = (W::Numbers::load(x), W::Numbers::load(y), W::Numbers::load(z));
    let mut gradients = [W::Numbers::all(0.0); 3];
    for axis in 0..3 {
        let [a, b, c] = [W::Numbers::all(a[axis]), W::Numbers::all(b[axis]), W::Numbers::all(c[axis])];
        gradients[axis] = a * x + b * y + c * z;
    }
    gradients
}
