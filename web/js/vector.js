/** @file Vectors of three numbers: world coordinates in mm (LPS), or directions. */

/** @typedef {[number, number, number]} Vector */

/** @param {Vector} a @param {Vector} b @returns {number} */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];

/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];

/** @param {Vector} a @param {number} factor @returns {Vector} */
export const scale = (a, factor) => [a[0] * factor, a[1] * factor, a[2] * factor];

/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** @param {Vector} a @returns {number} */
export const length = (a) => Math.hypot(a[0], a[1], a[2]);

/** Of length 1; zero stays zero. @param {Vector} a @returns {Vector} */
export const normalized = (a) => scale(a, 1 / (length(a) || 1));

/**
 * `a` turned about the unit vector `axis` (Rodrigues).
 * @param {Vector} a @param {Vector} axis @param {number} angle radians, counter-clockwise seen against the axis
 * @returns {Vector}
 */
export function turned(a, axis, angle) {
	const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
	return add(add(scale(a, cos), scale(cross(axis, a), sin)), scale(axis, dot(axis, a) * (1 - cos)));
}
