/**
 * @file The warp: where the pixels of a frame lie in the view that is wanted now.
 * Two homographies, one after the other. A frame's own takes an intermediate image into its picture: the service leaves that to us where
 * it can, for it is less to send. {@link carried} takes the picture to where the camera has gone since.
 */
import { axes, extent } from './camera.js';
import { dot, scale, subtract } from './vector.js';

/** @import {Camera} from './state.js' */
/** @import {Sphere} from './camera.js' */
/** @import {Size} from './request.js' */
/** @typedef {number[]} Homography nine numbers, row by row: homogeneous coordinates from such coordinates */

/** One after another, the last one first. @param {Homography} a @param {Homography} b @returns {Homography} */
const product = (a, b) => a.map((_, i) => [0, 1, 2].reduce((sum, k) => sum + a[i - (i % 3) + k] * b[3 * k + (i % 3)], 0));

/**
 * Where the picture of camera `from` lies in that of camera `to`, both centred, in units of half the shorter side, y down: what
 * the plane does that faces `from` in its target. Pans, zooms and rolls are exact in parallel projection, at any depth.
 * @param {Camera} from @param {Camera} to @param {Sphere} sphere @returns {Homography}
 */
export function carried(from, to, sphere) {
	if (from === to) return [1, 0, 0, 0, 1, 0, 0, 0, 1];
	const [a, b] = [axes(from), axes(to)];
	const [before, now] = [from, to].map((camera) => extent(camera, sphere) / 2);
	const shift = subtract(from.target ?? sphere.centre, to.target ?? sphere.centre);
	const row = (/** @type {import('./vector.js').Vector} */ v) => [dot(v, a.right) * before, -dot(v, a.up) * before, dot(v, shift)];
	const distance = to.projection === 'parallel' ? Infinity : sphere.radius / Math.sin((to.fov_y * Math.PI) / 360);
	const [x, y, nearer] = [row(scale(b.right, 1 / now)), row(scale(b.up, -1 / now)), row(scale(b.back, 1 / distance))];
	return [...x, ...y, -nearer[0], -nearer[1], 1 - nearer[2]];
}

/**
 * From a frame's pixels to a view's.
 * @param {{warp?: Homography, size: Size, state: {camera: Camera}}} frame of `size`, or an image that `warp` takes there
 * @param {Camera} camera @param {Sphere} sphere @param {Size} view @returns {Homography}
 */
export function placed({ warp, size, state }, camera, sphere, view) {
	const [half, wanted] = [size, view].map(({ width, height }) => Math.min(width, height) / 2);
	const centred = [1 / half, 0, -size.width / 2 / half, 0, 1 / half, -size.height / 2 / half, 0, 0, 1];
	const spread = [wanted, 0, view.width / 2, 0, wanted, view.height / 2, 0, 0, 1];
	const picture = product(product(spread, carried(state.camera, camera, sphere)), centred);
	return warp ? product(picture, warp) : picture;
}

/** As a style's `transform`. @param {Homography} h */
export const matrix3d = ([a, b, c, d, e, f, g, h, i]) => `matrix3d(${[a, d, 0, g, b, e, 0, h, 0, 0, 1, 0, c, f, 0, i]})`;
