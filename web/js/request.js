/**
 * @file From the state to what the service is asked.
 * Numbers are rounded here and in links by the same functions: whoever follows a link gets the same pixels.
 */
import { wrapped } from './camera.js';

/** @import {State, Camera, Lens} from './state.js' */
/** @typedef {{width: number, height: number}} Size pixels */

/** @param {number} value @param {number} digits after the point */
export const rounded = (value, digits) => Number(value.toFixed(digits)) || 0;

/** A camera whose numbers are short enough to read. @param {Camera} camera @returns {Camera} */
export function tidy(camera) {
	return {
		...camera,
		azimuth: rounded(wrapped(camera.azimuth), 2),
		elevation: rounded(camera.elevation, 2),
		roll: rounded(wrapped(camera.roll), 2),
		zoom: Number(camera.zoom.toPrecision(4)),
		fov_y: rounded(camera.fov_y, 1),
		target: camera.target && /** @type {import('./vector.js').Vector} */ (camera.target.map((mm) => Number(mm.toPrecision(7)))),
	};
}

/**
 * The camera as the service wants it. Its zoom is about the picture's height; ours is about the shorter side, so
 * that a scan fits a phone held upright as it fits a screen.
 * @param {Camera} camera @param {Size} size
 */
function orbit(camera, size) {
	const { target, zoom, fov_y, ...rest } = tidy(camera);
	return {
		...rest,
		zoom: zoom * Math.min(1, size.width / size.height),
		...(rest.projection === 'perspective' ? { fov_y } : {}),
		...(target ? { target } : {}),
	};
}

/** @param {Lens} lens */
function region({ center, radius, shows }) {
	const look = shows === 'fainter' ? { opacity: 0.15 } : shows === 'brightest' ? { blend: 'maximum' } : { transfer_function: shows };
	return { sphere: { center, radius }, ...look };
}

/** Whether pictures have a lens: projections do not, and voxels that are classified have no brightest values. @param {State} state */
export const hasLens = ({ lens, blend, algorithm }) => lens !== null && blend === 'composite' && !(lens.shows === 'brightest' && algorithm.includes('classifi'));

/**
 * The body of `POST /v1/volumes/{id}/frame`. Defaults are left out.
 * @param {State} state @param {Size} size @param {'draft' | 'standard' | 'high'} quality @param {boolean} [unwarped] for a page that warps pictures itself
 */
export function renderRequest(state, size, quality, unwarped) {
	const { plane, box } = state;
	const projects = state.blend !== 'composite';
	const clip = [plane && { plane }, box && { box }].filter(Boolean);
	return {
		camera: orbit(state.camera, size),
		image: { width: size.width, height: size.height, format: 'png', background: state.background, ...(unwarped ? { stage: 'intermediate' } : {}) },
		...(state.transfer && !projects ? { transfer_function: state.transfer } : {}),
		...(state.shading === null || projects ? {} : { shading: state.shading }),
		...(projects ? { blend: state.blend, ...(state.window ? { window: state.window } : {}) } : {}),
		...(state.depthCueing && !projects ? { depth_cueing: state.depthCueing } : {}),
		...(clip.length ? { clip } : {}),
		...(state.lens && hasLens(state) ? { regions: [region(state.lens)] } : {}),
		...(state.algorithm === 'auto' ? {} : { algorithm: state.algorithm }),
		quality,
	};
}

/** @param {string} id */
export const framePath = (id) => `v1/volumes/${encodeURIComponent(id)}/frame`;

/** A command that gives the same picture. @param {State} state @param {Size} size @param {'draft' | 'standard' | 'high'} quality @param {string} base URL of the page */
export function curlCommand(state, size, quality, base) {
	const quoted = (/** @type {string} */ text) => `'${text.replaceAll("'", `'\\''`)}'`;
	const body = JSON.stringify(renderRequest(state, size, quality));
	const url = new URL(framePath(state.volume), base).href;
	return `curl -o frame.png -H 'Content-Type: application/json' \\\n  -d ${quoted(body)} \\\n  ${quoted(url)}`;
}
