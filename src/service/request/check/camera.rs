//! The camera: one of three ways to tell it, and its ranges.

use std::ops::RangeInclusive;

use glam::{DMat4, DVec3};

use super::super::fields::{CameraFields, LookAtFields, MatricesFields};
use super::Refusals;
use crate::render::{Camera, LookAt, Orbit, Projection};

/// Degrees: beyond, a float's steps show as jumps of the camera.
const ANGLE: RangeInclusive<f64> = -1e6..=1e6;
const ZOOM: RangeInclusive<f64> = 1e-3..=1e3;
/// Degrees: at 180 the image plane is infinite.
const FOV_Y: RangeInclusive<f64> = 1.0..=170.0;
const VIEW_HEIGHT: RangeInclusive<f64> = 1e-6..=1e9;
const MATRIX_ELEMENT: RangeInclusive<f64> = -1e12..=1e12;

impl Refusals {
    pub(super) fn camera(&mut self, camera: &CameraFields) -> Camera {
        let orbit_fields = [
            ("azimuth", camera.azimuth.is_some()),
            ("elevation", camera.elevation.is_some()),
            ("roll", camera.roll.is_some()),
            ("zoom", camera.zoom.is_some()),
            ("target", camera.target.is_some()),
        ];
        let told_by = match (&camera.look_at, &camera.matrices) {
            (None, None) => None,
            (Some(_), _) => Some("look_at"),
            (None, Some(_)) => Some("matrices"),
        };
        if let Some(told_by) = told_by {
            for (name, _) in orbit_fields.iter().filter(|(_, there)| *there) {
                self.refuse(
                    format!("/camera/{name}"),
                    format!("belongs to an orbit, but the camera is told by {told_by}"),
                );
            }
        }
        self.range("/camera/fov_y", camera.fov_y, FOV_Y);
        self.range("/camera/view_height", camera.view_height, VIEW_HEIGHT);
        if camera.view_height.is_some() && camera.look_at.is_none() {
            self.refuse("/camera/view_height", "belongs to look_at; an orbit has zoom");
        }
        match (&camera.look_at, &camera.matrices) {
            (Some(_), Some(_)) => {
                self.refuse("/camera/matrices", "expected one of orbit, look_at and matrices, got two");
                Camera::Orbit(Orbit::default())
            }
            (Some(look), None) => Camera::LookAt(self.look_at(camera, look)),
            (None, Some(matrices)) => self.matrices(camera, matrices),
            (None, None) => Camera::Orbit(self.orbit(camera)),
        }
    }

    fn orbit(&mut self, camera: &CameraFields) -> Orbit {
        let default = Orbit::default();
        self.range("/camera/azimuth", camera.azimuth, ANGLE);
        self.range("/camera/elevation", camera.elevation, ANGLE);
        self.range("/camera/roll", camera.roll, ANGLE);
        self.range("/camera/zoom", camera.zoom, ZOOM);
        Orbit {
            projection: camera.projection.map_or(default.projection, Projection::from),
            azimuth: camera.azimuth.unwrap_or(default.azimuth),
            elevation: camera.elevation.unwrap_or(default.elevation),
            roll: camera.roll.unwrap_or(default.roll),
            zoom: camera.zoom.unwrap_or(default.zoom),
            fov_y: camera.fov_y.unwrap_or(default.fov_y),
            target: camera.target.map(|target| self.vector("/camera/target", target)),
        }
    }

    fn look_at(&mut self, camera: &CameraFields, look: &LookAtFields) -> LookAt {
        let default = Orbit::default();
        LookAt {
            projection: camera.projection.map_or(default.projection, Projection::from),
            position: self.vector("/camera/look_at/position", look.position),
            target: self.vector("/camera/look_at/target", look.target),
            up: look.up.map_or(DVec3::Z, |up| self.vector("/camera/look_at/up", up)),
            view_height: camera.view_height,
            fov_y: camera.fov_y.unwrap_or(default.fov_y),
        }
    }

    fn matrices(&mut self, camera: &CameraFields, matrices: &MatricesFields) -> Camera {
        for (name, there) in [("projection", camera.projection.is_some()), ("fov_y", camera.fov_y.is_some())] {
            if there {
                self.refuse(format!("/camera/{name}"), "the projection matrix says it already");
            }
        }
        self.elements("/camera/matrices/view", &matrices.view, &MATRIX_ELEMENT);
        self.elements("/camera/matrices/projection", &matrices.projection, &MATRIX_ELEMENT);
        Camera::Matrices {
            view: DMat4::from_cols_array(&matrices.view),
            projection: DMat4::from_cols_array(&matrices.projection),
        }
    }
}
