//! What looks otherwise where: clip regions, regions, labels and meshes.

use std::ops::RangeInclusive;

use glam::{DAffine3, DMat3, DMat4, DVec3, DVec4};

use super::super::fields::{
    BoxFields, ClipFields, GeometryFields, HullFields, Keep, LabelFields, LabelsFields, PlaneFields, RegionFields,
    SphereFields,
};
use super::super::{AlgorithmChoice, GeometryRequest, LabelRequest, LabelsRequest, RegionRequest};
use super::{POSITION, Refusals, projection};
use crate::classify::Color;
use crate::render::regions::MAX_REGIONS;
use crate::render::{Ball, Clip, HalfSpace, IntensityProjection};

/// Labels of a segmentation that something is told of.
const MAX_LABELS: usize = 64;
/// Points of a convex hull. Its sides are found by trying all planes through three of them.
const MAX_HULL: usize = 32;
/// Of a sphere, mm.
const RADIUS: RangeInclusive<f64> = 1e-3..=1e9;
/// Regions that cut something away; a box is six half-spaces.
const MAX_CLIP: usize = 16;
/// Regions that look otherwise. Pieces of rays within and between them are drawn layer by layer.
const MAX_SHOWN_REGIONS: usize = 4;
const _: () = assert!(MAX_CLIP + MAX_SHOWN_REGIONS <= MAX_REGIONS);
const REGION_OPACITY: RangeInclusive<f64> = 0.0..=1.0;
/// Meshes in one frame.
const MAX_GEOMETRY: usize = 32;
/// Of a mesh whose colour is not told.
const MESH_COLOR: Color = Color([0.8; 3]);

impl Refusals {
    /// What is left, all of which is within it, and what is cut out of that.
    pub(super) fn clip(&mut self, regions: Vec<ClipFields>) -> (Clip, Vec<Clip>) {
        if regions.len() > MAX_CLIP {
            self.refuse("/clip", format!("expected at most {MAX_CLIP} regions, got {}", regions.len()));
        }
        let (mut left, mut cut_out) = (Clip::default(), vec![]);
        for (index, region) in regions.into_iter().enumerate() {
            let outside = region.keep == Some(Keep::Outside);
            let is_plane = region.plane.is_some();
            let shape =
                self.convex(&format!("/clip/{index}"), (region.plane, region.r#box, region.sphere, region.hull));
            match (outside, is_plane) {
                (false, _) => {
                    left.halves.extend(shape.halves);
                    left.balls.extend(shape.balls);
                }
                // All that is not in one half is in the other.
                (true, true) => left.halves.extend(shape.halves.iter().map(HalfSpace::other)),
                (true, false) => cut_out.push(shape),
            }
        }
        (left, cut_out)
    }

    /// What is shown in another way; the frame itself is of `around`.
    pub(super) fn regions(
        &mut self,
        regions: Vec<RegionFields>,
        around: Option<IntensityProjection>,
        algorithm: AlgorithmChoice,
    ) -> Vec<RegionRequest> {
        // What they have classified is of no use to a frame of rays, as all are where one projects.
        let of_voxels = matches!(algorithm, AlgorithmChoice::Classified | AlgorithmChoice::FastClassification);
        if regions.len() > MAX_SHOWN_REGIONS {
            self.refuse("/regions", format!("expected at most {MAX_SHOWN_REGIONS} regions, got {}", regions.len()));
        }
        let region = |(index, region): (usize, RegionFields)| {
            let place = format!("/regions/{index}");
            self.range(format!("{place}/opacity"), region.opacity, REGION_OPACITY);
            if region.blend.is_some() && of_voxels {
                self.refuse(format!("{place}/blend"), "goes with preintegrated and raycast");
            }
            RegionRequest {
                shape: self.convex(&place, (region.plane, region.r#box, region.sphere, region.hull)),
                transfer: region.transfer_function.map(|transfer| self.transfer(&place, Some(transfer))),
                opacity: region.opacity.unwrap_or(1.0),
                shading: region.shading.map(|shading| self.shading(&place, Some(shading))),
                projection: region.blend.map_or(around, projection),
                window: region
                    .window
                    .map(|window| self.window(&place, region.blend.and_then(projection), Some(window))),
            }
        };
        regions.into_iter().enumerate().map(region).collect()
    }

    pub(super) fn labels(&mut self, fields: LabelsFields) -> LabelsRequest {
        if fields.looks.len() > MAX_LABELS {
            self.refuse("/labels/looks", format!("expected at most {MAX_LABELS} labels, got {}", fields.looks.len()));
        }
        let look = |(index, look): (usize, LabelFields)| {
            let place = format!("/labels/looks/{index}");
            self.range(format!("{place}/opacity"), look.opacity, REGION_OPACITY);
            let color = look.color.and_then(|text| {
                let color = Color::from_hex(&text);
                if color.is_none() {
                    self.refuse(format!("{place}/color"), "expected \"#rrggbb\"");
                }
                color
            });
            LabelRequest {
                label: look.label,
                opacity: if look.visible == Some(false) { 0.0 } else { look.opacity.unwrap_or(1.0) },
                color,
                transfer: look.transfer_function.map(|transfer| self.transfer(&place, Some(transfer))),
            }
        };
        LabelsRequest { volume: fields.volume, looks: fields.looks.into_iter().enumerate().map(look).collect() }
    }

    pub(super) fn geometry(&mut self, geometry: Vec<GeometryFields>) -> Vec<GeometryRequest> {
        if geometry.len() > MAX_GEOMETRY {
            self.refuse("/geometry", format!("expected at most {MAX_GEOMETRY} meshes, got {}", geometry.len()));
        }
        let solid = |(index, fields): (usize, GeometryFields)| {
            let place = format!("/geometry/{index}");
            if fields.opacity.is_some_and(|opacity| opacity != 1.0) {
                self.refuse(format!("{place}/opacity"), "expected 1: meshes are opaque");
            }
            let color = fields.color.as_deref().map_or(Some(MESH_COLOR), Color::from_hex);
            if color.is_none() {
                self.refuse(format!("{place}/color"), "expected \"#rrggbb\"");
            }
            let pose = fields.pose.map_or(DMat4::IDENTITY, |pose| DMat4::from_cols_array(&pose));
            self.elements(&format!("{place}/pose"), &pose.to_cols_array(), &POSITION);
            let size = DMat3::from_mat4(pose).determinant().abs();
            if (pose.row(3) - DVec4::W).abs().max_element() > 1e-6 || !(size.is_normal() && size.recip().is_normal()) {
                let detail = "expected an affine transform with an inverse, column by column";
                self.refuse(format!("{place}/pose"), detail);
            }
            GeometryRequest {
                mesh: fields.mesh,
                color: color.unwrap_or(MESH_COLOR),
                world_from_mesh: DAffine3::from_mat4(pose),
            }
        };
        geometry.into_iter().enumerate().map(solid).collect()
    }

    /// A convex part of the world; `place` points to what tells it.
    fn convex(
        &mut self,
        place: &str,
        told: (Option<PlaneFields>, Option<BoxFields>, Option<SphereFields>, Option<HullFields>),
    ) -> Clip {
        match told {
            (Some(plane), None, None, None) => Clip { halves: vec![self.plane(place, &plane)], balls: vec![] },
            (None, Some(fields), None, None) => Clip { halves: self.sides(place, &fields), balls: vec![] },
            (None, None, Some(sphere), None) => {
                let centre = self.vector(&format!("{place}/sphere/center"), sphere.center);
                self.range(format!("{place}/sphere/radius"), Some(sphere.radius), RADIUS);
                Clip { halves: vec![], balls: vec![Ball::new(centre, sphere.radius)] }
            }
            (None, None, None, Some(hull)) => self.hull(&format!("{place}/hull/points"), &hull.points),
            _ => {
                self.refuse(place, "expected one of plane, box, sphere and hull");
                Clip::default()
            }
        }
    }

    /// The half that the normal points into.
    fn plane(&mut self, pointer: &str, plane: &PlaneFields) -> HalfSpace {
        let point = self.vector(&format!("{pointer}/plane/point"), plane.point);
        let normal = self.vector(&format!("{pointer}/plane/normal"), plane.normal).try_normalize();
        if normal.is_none() {
            self.refuse(format!("{pointer}/plane/normal"), "expected a direction of length above 0");
        }
        let inwards = normal.unwrap_or(DVec3::Z);
        HalfSpace { normal: inwards, offset: -inwards.dot(point) }
    }

    fn hull(&mut self, pointer: &str, points: &[[f64; 3]]) -> Clip {
        if points.len() > MAX_HULL {
            self.refuse(pointer, format!("expected at most {MAX_HULL} points, got {}", points.len()));
            return Clip::default();
        }
        let at = |(index, point): (usize, &[f64; 3])| self.vector(&format!("{pointer}/{index}"), *point);
        let points: Vec<_> = points.iter().enumerate().map(at).collect();
        Clip::hull(&points).unwrap_or_else(|| {
            self.refuse(pointer, "expected points that do not all lie in one plane");
            Clip::default()
        })
    }

    fn sides(&mut self, pointer: &str, region: &BoxFields) -> Vec<HalfSpace> {
        let min = self.vector(&format!("{pointer}/box/min"), region.min);
        let max = self.vector(&format!("{pointer}/box/max"), region.max);
        for axis in (0..3).filter(|&axis| min[axis] >= max[axis]) {
            let detail = format!("expected more than min's {}, got {}", min[axis], max[axis]);
            self.refuse(format!("{pointer}/box/max/{axis}"), detail);
        }
        let side = |axis: usize| {
            let normal = DVec3::AXES[axis];
            [HalfSpace { normal, offset: -min[axis] }, HalfSpace { normal: -normal, offset: max[axis] }]
        };
        let halves = (0..3).flat_map(side).collect();
        let Some(pose) = region.pose else { return halves };
        self.elements(&format!("{pointer}/box/pose"), &pose, &POSITION);
        let world_from_box = DMat4::from_cols_array(&pose);
        let turn = DMat3::from_mat4(world_from_box);
        let turned = (turn * turn.transpose() - DMat3::IDENTITY).to_cols_array().iter().all(|e| e.abs() < 1e-4);
        if !turned || (world_from_box.row(3) - DVec4::W).abs().max_element() > 1e-6 {
            self.refuse(format!("{pointer}/box/pose"), "expected a rotation and a translation, column by column");
            return vec![];
        }
        let box_from_world = DAffine3::from_mat3_translation(turn, world_from_box.w_axis.truncate()).inverse();
        Clip { halves, balls: vec![] }.told_by(box_from_world).halves
    }
}
