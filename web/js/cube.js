/**
 * @file The orientation cube: how the patient lies in the picture, and a way to turn there.
 * Keyboards and screen readers have six plain buttons.
 */
import { el, svg } from './dom.js';
import { ANATOMICAL, axes } from './camera.js';
import { dot } from './vector.js';

/** @typedef {keyof typeof ANATOMICAL} Name */

/** Each faces whoever looks from there: its letter runs to the right and stands up. */
const FACES = /** @type {[Name, typeof ANATOMICAL.A][]} */ (Object.entries(ANATOMICAL)).map(([name, from]) => ({ name, title: from.name, ...axes({ ...from, roll: 0 }) }));
const HALF = 21;

export class Cube {
	/** @param {import('./state.js').Store} store @param {(name: Name) => void} lookFrom */
	constructor(store, lookFrom) {
		this.store = store;
		this.faces = FACES.map(({ name, title }) => svg('g', { class: `face face-${name}`, onclick: () => lookFrom(name) },
			svg('title', {}, title),
			svg('rect', { x: -HALF, y: -HALF, width: 2 * HALF, height: 2 * HALF }),
			svg('text', { 'text-anchor': 'middle', y: 9 }, name)));
		const cube = svg('svg', { class: 'cube', viewBox: '-40 -40 80 80', width: 80, height: 80, 'aria-hidden': 'true' }, ...this.faces);
		const buttons = FACES.map(({ name, title }) =>
			el('button', { type: 'button', title: `${title} (${name})`, 'aria-label': `Look from ${title.toLowerCase()}`, onclick: () => lookFrom(name) }, name));
		this.element = el('div', { class: 'orientation' }, cube, el('div', { class: 'sides', role: 'group', 'aria-label': 'Anatomical views' }, ...buttons));
		store.subscribe((state, before) => state.camera !== before.camera && this.draw());
		this.draw();
	}

	draw() {
		const { right, up, back } = axes(this.store.state.camera);
		FACES.forEach(({ back: out, right: along, up: upward }, i) => {
			const seen = dot(out, back);
			const face = this.faces[i];
			face.toggleAttribute('hidden', seen < 0.02);
			const centre = [dot(out, right) * HALF, -dot(out, up) * HALF];
			const map = [dot(along, right), -dot(along, up), -dot(upward, right), dot(upward, up), ...centre];
			face.setAttribute('transform', `matrix(${map.map((n) => n.toFixed(4)).join(' ')})`);
			face.setAttribute('fill-opacity', (0.55 + 0.4 * Math.max(0, seen)).toFixed(2));
		});
	}
}
