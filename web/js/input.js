/**
 * @file Pointers, wheel and keys on the picture, as changes of the camera.
 * A finger has no modifiers: what they do can be chosen as the tool of a plain drag, and two fingers pan, enlarge and roll at once.
 */
import { ANATOMICAL, orbited, panned, spun, swivelled, zoomed } from './camera.js';
import { ARROWS } from './dom.js';
import { DEFAULT_CAMERA } from './state.js';

/** @typedef {'orbit' | 'pan' | 'zoom' | 'roll' | 'window'} Tool */
/** @typedef {[number, number]} Point picture coordinates: the shorter side is -1..1, y up */
/** @import {Sphere} from './camera.js' */

/** Degrees by which an arrow key turns. */
const STEP = 5;

export class Input {
	/** @type {Map<number, Point>} */ #pointers = new Map();
	/** @type {Tool} */ #drag = 'orbit';
	/** The handle in hand, or -1. */ #held = -1;
	/** What a plain drag does. @type {Tool} */ tool = 'orbit';
	/** Whether turning keeps the scan upright. */ upright = false;

	/**
	 * @param {HTMLElement} element
	 * @param {import('./state.js').Store} store
	 * @param {() => Sphere | null} sphere
	 * @param {import('./handles.js').Handles} handles
	 * @param {{drag: (dx: number, dy: number) => void, commit: () => void}} windowing
	 * @param {(name: keyof typeof ANATOMICAL) => void} lookFrom
	 */
	constructor(element, store, sphere, handles, windowing, lookFrom) {
		this.element = element;
		this.store = store;
		this.sphere = sphere;
		this.handles = handles;
		this.windowing = windowing;
		this.lookFrom = lookFrom;
		element.addEventListener('pointerdown', (event) => this.#down(event));
		element.addEventListener('pointermove', (event) => this.#move(event));
		for (const end of /** @type {const} */ (['pointerup', 'pointercancel'])) element.addEventListener(end, (event) => this.#up(event));
		element.addEventListener('wheel', (event) => this.#wheel(event), { passive: false });
		element.addEventListener('contextmenu', (event) => event.preventDefault());
		element.addEventListener('dblclick', () => this.fit());
		element.addEventListener('keydown', (event) => this.#key(event));
	}

	/** The whole scan, from where it is seen. */
	fit() {
		this.store.setCamera({ zoom: DEFAULT_CAMERA.zoom, target: null });
	}

	/** @param {MouseEvent} event @returns {Point} */
	#at({ clientX, clientY }) {
		const { left, top, width, height } = this.element.getBoundingClientRect();
		return [(clientX - left - width / 2) / this.#half, (top + height / 2 - clientY) / this.#half];
	}

	/** Pixels of the unit of picture coordinates. */
	get #half() {
		return Math.min(this.element.clientWidth, this.element.clientHeight) / 2;
	}

	/** @param {PointerEvent} event */
	#down(event) {
		this.element.setPointerCapture(event.pointerId);
		this.#pointers.set(event.pointerId, this.#at(event));
		this.#held = this.handles.near(this.#at(event), this.#half);
		if (event.button === 1) event.preventDefault();
		this.#drag = event.button === 1 || event.shiftKey ? 'pan'
			: event.button === 2 || event.ctrlKey || event.metaKey ? 'window'
			: event.altKey ? 'roll'
			: this.tool;
	}

	/** @param {PointerEvent} event */
	#move(event) {
		const before = this.#pointers.get(event.pointerId);
		const sphere = this.sphere();
		if (!before || !sphere) return;
		const now = this.#at(event);
		const other = [...this.#pointers].find(([id]) => id !== event.pointerId)?.[1];
		this.#pointers.set(event.pointerId, now);
		if (other) this.#pinch(sphere, before, now, other);
		else this.#dragged(sphere, before, now);
	}

	/** @param {PointerEvent} event */
	#up(event) {
		this.#pointers.delete(event.pointerId);
		const sphere = this.sphere();
		if (this.#held >= 0 && sphere) this.handles.drag(this.#held, sphere, [0, 0]);
		else if (this.#drag === 'window') this.windowing.commit();
		this.#held = -1;
	}

	/** @param {Sphere} sphere @param {Point} before @param {Point} now */
	#dragged(sphere, before, now) {
		const { camera } = this.store.state;
		const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
		if (this.#held >= 0) this.handles.drag(this.#held, sphere, [dx, dy]);
		else if (this.#drag === 'window') this.windowing.drag(dx, dy);
		else if (this.#drag === 'pan') this.store.setCamera(panned(camera, sphere, dx, dy), true);
		else if (this.#drag === 'zoom') this.store.setCamera(zoomed(camera, sphere, Math.exp(dy * 1.5), [0, 0]), true);
		else if (this.#drag === 'roll') this.store.setCamera(spun(camera, [0, 0, 1], turn([0, 0], before, now)), true);
		else this.store.setCamera(this.upright ? swivelled(camera, dx, dy) : orbited(camera, before, now), true);
	}

	/** One of two fingers moves, the other stays. @param {Sphere} sphere @param {Point} before @param {Point} now @param {Point} other */
	#pinch(sphere, before, now, other) {
		const { camera } = this.store.state;
		const apart = (/** @type {Point} */ p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1e-3;
		/** @type {Point} */
		const middle = [(before[0] + other[0]) / 2, (before[1] + other[1]) / 2];
		const rolled = { ...camera, ...spun(camera, [0, 0, 1], turn(other, before, now)) };
		const enlarged = { ...rolled, ...zoomed(rolled, sphere, apart(now) / apart(before), middle) };
		const moved = panned(enlarged, sphere, (now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
		this.store.setCamera({ ...enlarged, ...moved }, true);
	}

	/** @param {WheelEvent} event */
	#wheel(event) {
		event.preventDefault();
		const sphere = this.sphere();
		if (!sphere) return;
		// Lines and pages as pixels; a pinch on a trackpad comes as a wheel with Ctrl.
		const pixels = event.deltaY * [1, 16, 400][event.deltaMode];
		const factor = Math.exp(-Math.max(-240, Math.min(240, pixels)) * (event.ctrlKey ? 0.01 : 0.0015));
		this.store.setCamera(zoomed(this.store.state.camera, sphere, factor, this.#at(event)), true);
	}

	/** @param {KeyboardEvent} event */
	#key(event) {
		const sphere = this.sphere();
		if (!sphere || event.ctrlKey || event.metaKey || event.altKey) return;
		const patch = this.#keyed(sphere, event);
		if (patch) this.store.setCamera(patch, true);
		else if (event.key.toUpperCase() in ANATOMICAL) this.lookFrom(/** @type {keyof typeof ANATOMICAL} */ (event.key.toUpperCase()));
		else if (event.key === '0' || event.key === 'Home') this.fit();
		else return;
		event.preventDefault();
	}

	/** @param {Sphere} sphere @param {KeyboardEvent} event @returns {Partial<import('./state.js').Camera> | null} */
	#keyed(sphere, { key, shiftKey }) {
		const { camera } = this.store.state;
		const arrow = ARROWS[key];
		if (arrow && shiftKey) return panned(camera, sphere, arrow[0] * 0.05, arrow[1] * 0.05);
		if (arrow && this.upright) return swivelled(camera, (arrow[0] * STEP) / 90, (arrow[1] * STEP) / 90);
		if (arrow) return spun(camera, [-arrow[1], arrow[0], 0], (STEP * Math.PI) / 180);
		if (key === '+' || key === '=') return zoomed(camera, sphere, 1.1, [0, 0]);
		if (key === '-' || key === '_') return zoomed(camera, sphere, 1 / 1.1, [0, 0]);
		if (key === '[' || key === ']') return spun(camera, [0, 0, 1], ((key === '[' ? STEP : -STEP) * Math.PI) / 180);
		return null;
	}
}

/** The angle at `centre` from one point to another, counter-clockwise. @param {Point} centre @param {Point} from @param {Point} to */
function turn(centre, from, to) {
	const angle = Math.atan2(to[1] - centre[1], to[0] - centre[0]) - Math.atan2(from[1] - centre[1], from[0] - centre[0]);
	return Math.atan2(Math.sin(angle), Math.cos(angle));
}
