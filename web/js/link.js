/**
 * @file The state as the page's fragment, `#volume=head&azimuth=30&preset=ct-bone`, and back.
 * It has the names of the frame route's query and only what differs from the defaults; what cannot be understood is left at its
 * default: half a link still shows the scan.
 */
import { DEFAULTS, DEFAULT_CAMERA, DEFAULT_SHADING } from './state.js';
import { tidy } from './request.js';

/** @import {State, Camera, Shading, TransferFunction} from './state.js' */
/** @import {Vector} from './vector.js' */

const CAMERA_NUMBERS = /** @type {const} */ (['azimuth', 'elevation', 'roll', 'zoom', 'fov_y']);
/** @type {State['quality'][]} */
const QUALITIES = ['auto', 'draft', 'standard', 'high'];
/** @type {State['algorithm'][]} */
const ALGORITHMS = ['auto', 'classified', 'fast-classification', 'preintegrated', 'raycast'];
/** @type {State['blend'][]} */
const BLENDS = ['composite', 'maximum', 'minimum', 'average'];
const COLOR = /^[0-9a-f]{6}$/i;

/** @param {State} state @returns {string} with its leading `#` */
export function toHash(state) {
	/** @type {[string, string | number][]} */
	const pairs = [['volume', state.volume]];
	const camera = tidy(state.camera);
	for (const name of CAMERA_NUMBERS) if (camera[name] !== DEFAULT_CAMERA[name]) pairs.push([name, camera[name]]);
	if (camera.projection !== DEFAULT_CAMERA.projection) pairs.push(['projection', camera.projection]);
	if (camera.target) pairs.push(['target', camera.target.join(',')]);
	if (typeof state.transfer === 'string') pairs.push(['preset', state.transfer]);
	else if (state.transfer) pairs.push(['tf', writeTransfer(state.transfer)]);
	if (state.shading !== null) pairs.push(['shading', writeShading(state.shading)]);
	if (state.blend !== DEFAULTS.blend) pairs.push(['blend', state.blend]);
	if (state.window) pairs.push(['window', `${state.window.center},${state.window.width}`]);
	if (state.depthCueing) pairs.push(['depth', `${state.depthCueing.front},${state.depthCueing.density}`]);
	if (state.plane) pairs.push(['plane', [...state.plane.point, ...state.plane.normal].join(',')]);
	if (state.box) pairs.push(['box', [...state.box.min, ...state.box.max].join(',')]);
	if (state.lens) {
		const { center, radius, shows } = state.lens;
		pairs.push(['lens', `${[...center, radius].join(',')};${typeof shows === 'string' ? shows : writeTransfer(shows)}`]);
	}
	if (state.background !== DEFAULTS.background) pairs.push(['background', state.background.replace('#', '')]);
	if (state.algorithm !== DEFAULTS.algorithm) pairs.push(['algorithm', state.algorithm]);
	if (state.quality !== DEFAULTS.quality) pairs.push(['quality', state.quality]);
	// Commas and the like may stand in a fragment; escaped they would make a link twice as long.
	const written = (/** @type {string | number} */ value) => encodeURIComponent(value).replace(/%(2C|3A|3B)/g, decodeURIComponent);
	return `#${pairs.map(([name, value]) => `${name}=${written(value)}`).join('&')}`;
}

/** @param {string} hash with or without its `#` @returns {State} */
export function fromHash(hash) {
	const pairs = new URLSearchParams(hash.replace(/^#/, '').replaceAll('+', '%2B'));
	const text = (/** @type {string} */ name) => pairs.get(name) ?? '';
	/** @type {Camera} */
	const camera = { ...DEFAULT_CAMERA };
	for (const name of CAMERA_NUMBERS) camera[name] = number(text(name)) ?? camera[name];
	if (text('projection') === 'perspective') camera.projection = 'perspective';
	camera.target = /** @type {Vector | null} */ (numbers(text('target'), 3));
	const [window, depth] = [numbers(text('window'), 2), numbers(text('depth'), 2)];
	const background = text('background');
	const [[point, normal], [min, max]] = [vectors(text('plane')), vectors(text('box'))];
	return {
		volume: text('volume'),
		camera,
		transfer: readTransfer(text('tf')) ?? (text('preset') || null),
		shading: readShading(text('shading')),
		blend: one(text('blend'), BLENDS) ?? DEFAULTS.blend,
		window: window && { center: window[0], width: window[1] },
		depthCueing: depth && { front: depth[0], density: depth[1] },
		plane: normal?.some(Boolean) ? { point, normal } : null,
		box: max?.every((mm, axis) => mm > min[axis]) ? { min, max } : null,
		lens: readLens(text('lens')),
		background: background === 'transparent' ? background : COLOR.test(background) ? `#${background}` : DEFAULTS.background,
		algorithm: one(text('algorithm'), ALGORITHMS) ?? DEFAULTS.algorithm,
		quality: one(text('quality'), QUALITIES) ?? DEFAULTS.quality,
	};
}

/** The name that a text is. @template {string} T @param {string} text @param {T[]} names */
const one = (text, names) => names.find((name) => name === text);

/** @param {string} text */
function number(text) {
	const value = Number(text);
	return text.trim() !== '' && Number.isFinite(value) ? value : null;
}

/** @param {string} text @param {number} count @returns {number[] | null} */
function numbers(text, count) {
	const values = text.split(',').map(number);
	return values.length === count && values.every((value) => value !== null) ? /** @type {number[]} */ (values) : null;
}

/** Two, or none. @param {string} text */
function vectors(text) {
	const six = numbers(text, 6) ?? [];
	return /** @type {Vector[]} */ (six.length ? [six.slice(0, 3), six.slice(3)] : []);
}

/** `x,y,z,radius;` and what it shows. @param {string} text @returns {import('./state.js').Lens | null} */
function readLens(text) {
	const [place, ...shows] = text.split(';');
	const four = numbers(place, 4);
	const look = shows.join(';');
	return four && four[3] > 0 && look ? { center: [four[0], four[1], four[2]], radius: four[3], shows: readTransfer(look) ?? look } : null;
}

/** `value:opacity:rrggbb` for each point, then `d` and `g` where they are told. @param {TransferFunction} transfer */
export function writeTransfer({ points, opacity_distance, gradient_opacity }) {
	const parts = points.map(({ value, opacity, color }) => `${value}:${opacity}:${color.slice(1)}`);
	if (opacity_distance !== undefined) parts.push(`d:${opacity_distance}`);
	if (gradient_opacity?.length) parts.push(...gradient_opacity.map(({ value, opacity }) => `g:${value}:${opacity}`));
	return parts.join(';');
}

/** @param {string} text @returns {TransferFunction | null} */
function readTransfer(text) {
	/** @type {TransferFunction} */
	const transfer = { points: [] };
	for (const part of text ? text.split(';') : []) {
		const [first, second, third] = part.split(':');
		const [a, b] = [number(first), number(second ?? '')];
		if (first === 'd' && b !== null) transfer.opacity_distance = b;
		else if (first === 'g' && b !== null) (transfer.gradient_opacity ??= []).push({ value: b, opacity: number(third ?? '') ?? 1 });
		else if (a !== null && b !== null && COLOR.test(third ?? '')) transfer.points.push({ value: a, opacity: b, color: `#${third}` });
	}
	return transfer.points.length ? transfer : null;
}

/** `off`, `on`, or the four coefficients and the lights: `0.2,0.8,0.2,20;head;1,0,0,0.5`, with `,1` where it casts shadows. @param {Shading | boolean} shading */
function writeShading(shading) {
	if (typeof shading === 'boolean') return shading ? 'on' : 'off';
	const { ambient, diffuse, specular, shininess, lights } = shading;
	const lamps = lights.map((light) =>
		light === 'headlight' ? 'head' : [...light.direction, light.intensity, ...(light.shadows ? [1] : [])].join(','));
	return [[ambient, diffuse, specular, shininess].join(','), ...lamps].join(';');
}

/** @param {string} text @returns {Shading | boolean | null} */
function readShading(text) {
	if (text === 'on' || text === 'off') return text === 'on';
	const [first, ...lamps] = text.split(';');
	const coefficients = numbers(first, 4);
	if (!coefficients) return null;
	const [ambient, diffuse, specular, shininess] = coefficients;
	/** @type {Shading['lights']} */
	const lights = [];
	for (const lamp of lamps) {
		const parts = numbers(lamp, 4) ?? numbers(lamp, 5);
		if (lamp === 'head') lights.push('headlight');
		else if (parts) lights.push({ direction: [parts[0], parts[1], parts[2]], intensity: parts[3], ...(parts[4] ? { shadows: true } : {}) });
	}
	return { ...DEFAULT_SHADING, ambient, diffuse, specular, shininess, lights };
}
