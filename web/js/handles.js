/** @file Handles on the picture: what cuts the scan can be taken hold of where it is, as long as its panel is open. */
import { axes, seenAt } from './camera.js';
import { el } from './dom.js';
import { add, dot, scale } from './vector.js';

/** @import {Sphere} from './camera.js' */
/** @import {Store} from './state.js' */
/** @import {Vector} from './vector.js' */
/** @typedef {[number, number]} Point picture coordinates */
/** @typedef {{at: Vector, along: Vector | null, move: (to: Vector, moving: boolean) => void}} Handle goes `along` a direction of length 1, or with the pointer */

/** Pixels around a handle in which a pointer takes hold of it. */
const HOLD = 16;

export class Handles {
	element = el('div', { class: 'handles', 'aria-hidden': 'true' });

	/** @param {Store} store @param {() => Sphere | null} sphere @param {() => Handle[]} wanted those of now */
	constructor(store, sphere, wanted) {
		this.store = store;
		this.sphere = sphere;
		this.wanted = wanted;
		store.subscribe(() => this.draw());
		new ResizeObserver(() => this.draw()).observe(this.element);
	}

	draw() {
		const half = Math.min(this.element.clientWidth, this.element.clientHeight) / 2;
		this.element.replaceChildren(...this.#seen().map(([x, y]) => {
			const dot = el('span');
			dot.style.translate = `${x * half}px ${-y * half}px`;
			return dot;
		}));
	}

	/** @returns {Point[]} */
	#seen() {
		const sphere = this.sphere();
		return sphere ? this.wanted().map(({ at }) => seenAt(this.store.state.camera, sphere, at).point) : [];
	}

	/** The number of the handle that a pointer takes hold of, or -1. @param {Point} at @param {number} unit pixels */
	near([x, y], unit) {
		return this.#seen().findIndex((point) => Math.hypot(point[0] - x, point[1] - y) * unit < HOLD);
	}

	/** Moves a handle as far along as a pointer goes, and ends the move where it does not. @param {number} number @param {Sphere} sphere @param {Point} by */
	drag(number, sphere, [dx, dy]) {
		const { camera } = this.store.state;
		const { right, up } = axes(camera);
		const handle = this.wanted()[number];
		if (!handle) return;
		const { at, along, move } = handle;
		const { mm } = seenAt(camera, sphere, at);
		const [x, y] = along ? [dot(along, right), dot(along, up)] : [0, 0];
		// What points to the eye does not run away under a small move.
		const by = along ? scale(along, ((x * dx + y * dy) * mm) / Math.max(0.2, x * x + y * y)) : add(scale(right, dx * mm), scale(up, dy * mm));
		move(add(at, by), dx !== 0 || dy !== 0);
	}
}
