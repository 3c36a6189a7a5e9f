/** @file Transfer functions as data: what they give at a value, and how points and windows change them. */

/** @import {TransferFunction, ControlPoint, Window} from './state.js' */
/** @typedef {[number, number]} Range */

/**
 * Opacities near zero decide what one sees through, and a linear axis has no room for them: a
 * thousandth and a hundredth would share a pixel. The cube root gives the first percent a fifth of the height.
 * @param {number} opacity
 */
export const heightOf = (opacity) => Math.cbrt(opacity);

/** @param {number} height 0..1 */
export const opacityOf = (height) => Math.max(0, Math.min(1, height)) ** 3;

/** Opacity and colour at a value, as the service interpolates them. @param {ControlPoint[]} points @param {number} value @returns {ControlPoint} */
export function sampled(points, value) {
	const after = points.findIndex((point) => point.value > value);
	if (after === 0) return { ...points[0], value };
	if (after < 0) return { ...points[points.length - 1], value };
	const [a, b] = [points[after - 1], points[after]];
	const part = (value - a.value) / (b.value - a.value);
	return { value, opacity: a.opacity + (b.opacity - a.opacity) * part, color: mixed(a.color, b.color, part) };
}

/** @param {string} a @param {string} b `#rrggbb` @param {number} part */
function mixed(a, b, part) {
	const channel = (/** @type {string} */ color, /** @type {number} */ i) => parseInt(color.slice(1 + 2 * i, 3 + 2 * i), 16);
	const mix = (/** @type {number} */ i) => Math.round(channel(a, i) + (channel(b, i) - channel(a, i)) * part);
	return `#${[0, 1, 2].map((i) => mix(i).toString(16).padStart(2, '0')).join('')}`;
}

/** With a point added; gives its index too. @param {TransferFunction} transfer @param {ControlPoint} point @returns {[TransferFunction, number]} */
export function withPoint(transfer, point) {
	const after = transfer.points.findIndex(({ value }) => value > point.value);
	const index = after < 0 ? transfer.points.length : after;
	return [{ ...transfer, points: transfer.points.toSpliced(index, 0, point) }, index];
}

/** @param {TransferFunction} transfer @param {number} index @returns {TransferFunction} */
export const withoutPoint = (transfer, index) => ({ ...transfer, points: transfer.points.toSpliced(index, 1) });

/** With a point changed; it cannot pass its neighbours. @param {TransferFunction} transfer @param {number} index @param {Partial<ControlPoint>} patch @returns {TransferFunction} */
export function withChanged(transfer, index, patch) {
	const { points } = transfer;
	const point = { ...points[index], ...patch };
	point.value = Math.min(points[index + 1]?.value ?? Infinity, Math.max(points[index - 1]?.value ?? -Infinity, point.value));
	point.opacity = Math.min(1, Math.max(0, point.opacity));
	return { ...transfer, points: points.with(index, point) };
}

/** The values between the first and the last point. @param {TransferFunction} transfer @param {number} least width @returns {Window} */
export function windowOf({ points }, least) {
	const [first, last] = [points[0].value, points[points.length - 1].value];
	return { center: (first + last) / 2, width: Math.max(least, last - first) };
}

/** Moved and stretched from one window to another. @param {TransferFunction} transfer @param {Window} from @param {Window} to @returns {TransferFunction} */
export function windowed(transfer, from, to) {
	const moved = (/** @type {ControlPoint} */ point) =>
		({ ...point, value: short(to.center + ((point.value - from.center) * to.width) / from.width, to.width) });
	return { ...transfer, points: transfer.points.map(moved) };
}

/** A value with as many digits as matter within a range of this width. @param {number} value @param {number} width */
export function short(value, width) {
	const digits = Math.min(12, Math.max(0, 3 - Math.floor(Math.log10(width || 1))));
	return Number(value.toFixed(digits)) || 0;
}

/** A few round numbers within a range. @param {Range} range @returns {number[]} */
export function ticks([low, high]) {
	const rough = (high - low) / 5;
	const power = 10 ** Math.floor(Math.log10(rough));
	const step = [1, 2, 5, 10].map((n) => n * power).find((n) => n >= rough) ?? rough;
	const first = Math.ceil(low / step);
	const count = Math.floor(high / step) - first + 1;
	return Array.from({ length: count }, (_, i) => Number(((first + i) * step).toPrecision(10)));
}
