/**
 * @file Lamps: lights that stay where they are while the camera goes round the scan.
 * The pad is the half of a ball that faces the camera; where its dot is, the light comes from.
 */
import { axes } from './camera.js';
import { slider, toggle } from './controls.js';
import { ARROWS, el, iconButton, svg } from './dom.js';
import { rounded } from './request.js';
import { add, dot, normalized, scale } from './vector.js';

/** @import {Lamp, Camera, Shading} from './state.js' */
/** @typedef {Shading['lights']} Lights */

/** More lamps than these confuse more than they show. */
const MOST = 4;
/** Radius of a pad, and the room around it, pixels. */
const PAD = 30;
const ROOM = 4;
/** By which an arrow key moves a dot. */
const STEP = 0.1;

export class Lamps {
	/** @type {Lights} */ #lights = [];
	/** @type {LampRow[]} */ #rows = [];

	/** @param {() => Camera} camera @param {(lights: Lights, moving: boolean) => void} change */
	constructor(camera, change) {
		this.camera = camera;
		this.change = change;
		this.list = el('div', { class: 'lamps' });
		this.addButton = el('button', { type: 'button', class: 'quiet', onclick: () => this.#add() }, 'Add a lamp');
		this.element = el('div', {}, this.list, this.addButton);
	}

	/** @param {Lights} lights all of them, the headlight too */
	show(lights) {
		this.#lights = lights;
		const lamps = lights.filter((light) => light !== 'headlight');
		// Rows are kept while their number is the same, so that a drag survives.
		if (this.#rows.length !== lamps.length) {
			this.#rows = lamps.map((_, nth) => new LampRow(nth, this.camera, (patch, moving) => this.#changeLamp(nth, patch, moving)));
			this.list.replaceChildren(...this.#rows.map(({ element }) => element));
		}
		lamps.forEach((lamp, nth) => this.#rows[nth].show(lamp));
		this.addButton.hidden = lamps.length >= MOST;
	}

	/** From the upper left of what is seen now, as painters have it. */
	#add() {
		this.change([...this.#lights, { direction: direction(this.camera(), -0.6, 0.5), intensity: 0.8 }], false);
	}

	/** @param {number} nth among the lamps @param {Partial<Lamp> | null} patch `null` takes it away @param {boolean} moving */
	#changeLamp(nth, patch, moving) {
		let lamps = 0;
		const changed = this.#lights.flatMap((light) => {
			// One casts shadows.
			if (light === 'headlight' || lamps++ !== nth) return [patch?.shadows && light !== 'headlight' ? { ...light, shadows: undefined } : light];
			return patch ? [{ ...light, ...patch }] : [];
		});
		this.change(changed, moving);
	}
}

/** The direction to a point of the ball that faces the camera. @param {Camera} camera @param {number} x @param {number} y */
function direction(camera, x, y) {
	const { right, up, back } = axes(camera);
	const far = Math.max(1, Math.hypot(x, y) / 0.995);
	const [sx, sy] = [x / far, y / far];
	const towards = add(add(scale(right, sx), scale(up, sy)), scale(back, Math.sqrt(1 - sx * sx - sy * sy)));
	return /** @type {import('./vector.js').Vector} */ (towards.map((part) => rounded(part, 3)));
}

class LampRow {
	#x = 0;
	#y = 0;

	/** @param {number} nth @param {() => Camera} camera @param {(patch: Partial<Lamp> | null, moving: boolean) => void} change */
	constructor(nth, camera, change) {
		this.camera = camera;
		this.change = change;
		const side = 2 * (PAD + ROOM);
		this.dot = svg('circle', { r: 6, class: 'dot' });
		this.pad = svg('svg', {
			class: 'pad', viewBox: `${-side / 2} ${-side / 2} ${side} ${side}`, width: side, height: side,
			tabindex: 0, role: 'application', 'aria-label': `Direction of lamp ${nth + 1}; arrow keys move it`,
		}, svg('circle', { r: PAD, class: 'sphere' }), this.dot);
		this.pad.addEventListener('pointerdown', (event) => {
			this.pad.setPointerCapture(event.pointerId);
			this.#drag(event);
		});
		this.pad.addEventListener('pointermove', (event) => this.pad.hasPointerCapture(event.pointerId) && this.#drag(event));
		this.pad.addEventListener('keydown', (event) => this.#key(event));
		this.intensity = slider('Brightness', {
			min: 0, max: 2, step: 0.05, text: (value) => value.toFixed(2), change: (intensity, moving) => change({ intensity }, moving),
		});
		this.shadows = toggle('Shadows', (on) => change({ shadows: on || undefined }, false));
		const remove = iconButton('trash', `Remove lamp ${nth + 1}`, () => change(null, false));
		this.element = el('div', { class: 'lamp' }, this.pad, el('div', {}, this.intensity.element, this.shadows.element), remove);
	}

	/** @param {Lamp} lamp */
	show(lamp) {
		const { right, up, back } = axes(this.camera());
		const towards = normalized(lamp.direction);
		[this.#x, this.#y] = [dot(towards, right), dot(towards, up)];
		this.dot.setAttribute('transform', `translate(${(this.#x * PAD).toFixed(1)},${(-this.#y * PAD).toFixed(1)})`);
		this.dot.classList.toggle('behind', dot(towards, back) < 0);
		this.intensity.show(lamp.intensity);
		this.shadows.show(!!lamp.shadows);
	}

	/** @param {number} x @param {number} y */
	#aim(x, y) {
		this.change({ direction: direction(this.camera(), x, y) }, true);
	}

	/** @param {PointerEvent} event */
	#drag(event) {
		const { left, top, width, height } = this.pad.getBoundingClientRect();
		this.#aim((event.clientX - left - width / 2) / PAD, (top + height / 2 - event.clientY) / PAD);
	}

	/** @param {KeyboardEvent} event */
	#key(event) {
		const arrow = ARROWS[event.key];
		if (!arrow) return;
		event.preventDefault();
		this.#aim(this.#x + arrow[0] * STEP, this.#y + arrow[1] * STEP);
	}
}
