/**
 * @file The camera: how gestures turn, move and enlarge it.
 * The state keeps the service's orbit (azimuth, elevation, roll): what links, requests and people say. Turning happens on the camera's
 * axes and is read back into angles, so that nothing is lost at the poles.
 */
import { add, cross, dot, length, normalized, scale, subtract, turned } from './vector.js';

/** @import {Vector} from './vector.js' */
/** @import {Camera} from './state.js' */
/** @typedef {{right: Vector, up: Vector, back: Vector}} Axes `back` points from the target to the camera */
/** @typedef {{centre: Vector, radius: number}} Sphere the scan's bounding sphere, mm */

const DEGREES = 180 / Math.PI;

/** Zoom factors that the service takes leave room for pictures higher than wide. */
const ZOOM = { least: 0.05, most: 200 };

/** What a person sees first is what they came for: the six faces of the box, in the patient's terms. */
export const ANATOMICAL = {
	A: { name: 'Anterior', azimuth: 0, elevation: 0 },
	P: { name: 'Posterior', azimuth: 180, elevation: 0 },
	L: { name: 'Left', azimuth: 90, elevation: 0 },
	R: { name: 'Right', azimuth: -90, elevation: 0 },
	S: { name: 'Superior', azimuth: 0, elevation: 90 },
	I: { name: 'Inferior', azimuth: 0, elevation: -90 },
};

/** @param {Pick<Camera, 'azimuth' | 'elevation' | 'roll'>} camera @returns {Axes} */
export function axes({ azimuth, elevation, roll }) {
	const [a, e, r] = [azimuth / DEGREES, elevation / DEGREES, roll / DEGREES];
	/** @type {Vector} */
	const back = [Math.sin(a) * Math.cos(e), -Math.cos(a) * Math.cos(e), Math.sin(e)];
	/** @type {Vector} */
	const upright = [-Math.sin(a) * Math.sin(e), Math.cos(a) * Math.sin(e), Math.cos(e)];
	const level = cross(upright, back);
	return {
		right: add(scale(level, Math.cos(r)), scale(upright, Math.sin(r))),
		up: add(scale(level, -Math.sin(r)), scale(upright, Math.cos(r))),
		back,
	};
}

/** The angles whose axes these are; at the poles those with no roll. @param {Axes} turnedAxes */
export function angles({ right, up, back }) {
	const pole = Math.hypot(back[0], back[1]) < 1e-6;
	const sign = back[2] > 0 ? 1 : -1;
	const azimuth = pole ? Math.atan2(-sign * up[0], sign * up[1]) : Math.atan2(back[0], -back[1]);
	const elevation = pole ? (sign * Math.PI) / 2 : Math.asin(Math.min(1, Math.max(-1, back[2])));
	const unrolled = axes({ azimuth: azimuth * DEGREES, elevation: elevation * DEGREES, roll: 0 });
	const roll = Math.atan2(dot(right, unrolled.up), dot(right, unrolled.right));
	return { azimuth: azimuth * DEGREES, elevation: elevation * DEGREES, roll: roll * DEGREES };
}

/**
 * A drag on the trackball (Shoemake's sphere with Bell's hyperbola around it): the point of the scan
 * under the pointer follows it.
 * @param {Camera} camera
 * @param {[number, number]} from picture coordinates: the shorter side is -1..1, y up
 * @param {[number, number]} to
 */
export function orbited(camera, from, to) {
	const [a, b] = [onTrackball(from), onTrackball(to)];
	const axis = cross(a, b);
	const angle = Math.atan2(length(axis), dot(a, b));
	return spun(camera, normalized(axis), angle * 1.4);
}

/** @param {[number, number]} point @returns {Vector} */
function onTrackball([x, y]) {
	const squared = x * x + y * y;
	return normalized([x, y, squared < 0.5 ? Math.sqrt(1 - squared) : 0.5 / Math.sqrt(squared)]);
}

/**
 * Turns the scan, as it is seen, about an axis of the picture (x right, y up, z to the viewer).
 * @param {Camera} camera @param {Vector} axis of length 1 @param {number} angle radians
 */
export function spun(camera, axis, angle) {
	const { right, up, back } = axes(camera);
	const world = add(add(scale(right, axis[0]), scale(up, axis[1])), scale(back, axis[2]));
	// The scan stays where it is: the camera turns the other way.
	const turn = (/** @type {Vector} */ v) => turned(v, world, -angle);
	return angles({ right: turn(right), up: turn(up), back: turn(back) });
}

/** A drag that keeps the scan upright. @param {Camera} camera @param {number} dx @param {number} dy */
export function swivelled(camera, dx, dy) {
	const elevation = Math.min(90, Math.max(-90, camera.elevation - dy * 90));
	return { azimuth: wrapped(camera.azimuth - dx * 90), elevation };
}

/** @param {number} degrees */
export const wrapped = (degrees) => degrees - 360 * Math.round(degrees / 360);

/** Height of the target's plane that the picture's shorter side shows, mm. @param {Camera} camera @param {Sphere} sphere */
export function extent(camera, sphere) {
	const flat = (2 * sphere.radius) / camera.zoom;
	return camera.projection === 'parallel' ? flat : flat / Math.cos(camera.fov_y / 2 / DEGREES);
}

/** Where a point is seen, in picture coordinates, and how long their unit is there, mm. @param {Camera} camera @param {Sphere} sphere @param {Vector} point @returns {{point: [number, number], mm: number}} */
export function seenAt(camera, sphere, point) {
	const { right, up, back } = axes(camera);
	const offset = subtract(point, camera.target ?? sphere.centre);
	const nearer = camera.projection === 'parallel' ? 0 : (dot(back, offset) * Math.sin(camera.fov_y / 2 / DEGREES)) / sphere.radius;
	const mm = (extent(camera, sphere) / 2) * (1 - nearer);
	return { point: [dot(right, offset) / mm, dot(up, offset) / mm], mm };
}

/** Moves the scan in the picture's plane. @param {Camera} camera @param {Sphere} sphere @param {number} dx @param {number} dy as for {@link orbited} */
export function panned(camera, sphere, dx, dy) {
	const { right, up } = axes(camera);
	const mm = extent(camera, sphere) / 2;
	const target = camera.target ?? sphere.centre;
	return { target: subtract(target, add(scale(right, dx * mm), scale(up, dy * mm))) };
}

/** Enlarges by `factor` about a point of the picture, which stays where it is. @param {Camera} camera @param {Sphere} sphere @param {number} factor @param {[number, number]} at */
export function zoomed(camera, sphere, factor, [x, y]) {
	const zoom = Math.min(ZOOM.most, Math.max(ZOOM.least, camera.zoom * factor));
	const kept = 1 - camera.zoom / zoom;
	const { target } = panned(camera, sphere, -x * kept, -y * kept);
	return Math.abs(x) + Math.abs(y) < 1e-6 ? { zoom } : { zoom, target };
}

/** The way from one orientation to another, `part` of 0..1. @param {Camera} from @param {{azimuth: number, elevation: number, roll: number}} to @param {number} part */
export function between(from, to, part) {
	const [a, b] = [axes(from), axes(to)];
	// The turn between two frames, from the antisymmetric part and the trace of its matrix.
	const twice = add(add(cross(a.right, b.right), cross(a.up, b.up)), cross(a.back, b.back));
	const cosine = (dot(a.right, b.right) + dot(a.up, b.up) + dot(a.back, b.back) - 1) / 2;
	const angle = Math.atan2(length(twice) / 2, cosine);
	// Half a turn has no antisymmetric part; any axis across the view does, the upright one looks natural.
	const axis = length(twice) > 1e-6 ? normalized(twice) : a.up;
	const turn = (/** @type {Vector} */ v) => turned(v, axis, angle * part);
	return angles({ right: turn(a.right), up: turn(a.up), back: turn(a.back) });
}

/** Centre and radius of a scan's box of voxel centres. @param {{dimensions: number[], spacing: number[], origin: number[], direction: number[]}} volume @returns {Sphere} */
export function boundingSphere({ dimensions, spacing, origin, direction }) {
	const half = dimensions.map((n, axis) => ((n - 1) * spacing[axis]) / 2);
	const row = (/** @type {number} */ r) =>
		origin[r] + half.reduce((sum, mm, column) => sum + direction[3 * r + column] * mm, 0);
	return { centre: [row(0), row(1), row(2)], radius: Math.hypot(...half) };
}

/** Where that box begins along a direction, and how long it is there, mm for one of length 1. @param {Parameters<typeof boundingSphere>[0]} volume @param {Vector} along */
export function span(volume, along) {
	const size = volume.dimensions.reduce((sum, n, column) =>
		sum + Math.abs(along.reduce((part, a, r) => part + a * volume.direction[3 * r + column], 0) * (n - 1) * volume.spacing[column]), 0);
	return [dot(along, boundingSphere(volume).centre) - size / 2, size];
}

/** In words, for those who do not see the picture. @param {Camera} camera */
export function described(camera) {
	const { back } = axes(camera);
	const sides = [['left', 'right', back[0]], ['posterior', 'anterior', back[1]], ['superior', 'inferior', back[2]]];
	const named = sides.filter(([, , part]) => Math.abs(/** @type {number} */ (part)) > 0.35);
	named.sort((a, b) => Math.abs(/** @type {number} */ (b[2])) - Math.abs(/** @type {number} */ (a[2])));
	const from = named.map(([positive, negative, part]) => (/** @type {number} */ (part) > 0 ? positive : negative)).join(' and ');
	return `seen from ${from}, zoom ${camera.zoom.toFixed(2)}`;
}
