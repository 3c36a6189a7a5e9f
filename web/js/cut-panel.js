/**
 * @file The panel of cuts: a plane whose depth is one slider, a box, and a lens.
 * A slider away from its start cuts. Numbers are rounded here: links and requests have the same.
 */
import { axes, boundingSphere, span } from './camera.js';
import { section, select, slider, toggle } from './controls.js';
import { el } from './dom.js';
import { writeTransfer } from './link.js';
import { hasLens, rounded } from './request.js';
import { add, dot, scale } from './vector.js';

/** @import {Handle} from './handles.js' */
/** @import {Offer} from './looks.js' */
/** @import {Lens} from './state.js' */
/** @import {Vector} from './vector.js' */

/** Two for each axis, the one towards its negative end first. */
const SIDES = ['Right', 'Left', 'Front', 'Back', 'Bottom', 'Top'];

const PLACES = ['From the right', 'From the front', 'From below'];

/** What it can show besides presets. @type {{value: string, label: string}[]} */
const SHOWS = [{ value: 'fainter', label: 'All of it, fainter' }, { value: 'brightest', label: 'The brightest values' }];

/** @param {Lens['shows']} shows */
const told = (shows) => (typeof shows === 'string' ? shows : writeTransfer(shows));

/** Into the scan from the side with this number. @param {number} side */
const inward = (side) => /** @type {Vector} */ ([0, 1, 2].map((axis) => (axis === side >> 1 ? 1 - 2 * (side % 2) : 0)));

/** @param {Vector} v */
const short = (v) => /** @type {Vector} */ (v.map((n) => rounded(n, 4)));

export class CutPanel {
	/** Where the plane cut last; `null`: from the camera, wherever that is. @type {Vector | null} */ #normal = null;

	/** @param {import('./state.js').Store} store @param {() => import('./api.js').ReadyVolume | null} volume */
	constructor(store, volume) {
		this.store = store;
		this.volume = volume;
		const ruler = (/** @type {string} */ label, /** @type {() => Vector} */ normal, /** @type {(part: number, moving: boolean) => void} */ change) =>
			slider(label, { min: 0, max: 1, step: 0.005, change, text: (part) => `${Number((part * this.#span(normal())[1]).toPrecision(3))} mm` });
		this.depth = ruler('Depth', () => this.#direction, (part, moving) => this.#cut(this.#direction, part, moving));
		const from = (/** @type {string} */ label, /** @type {() => Vector} */ normal) =>
			el('button', { type: 'button', class: 'quiet', onclick: () => this.#cut(normal(), this.#depth || 0.5) }, label);
		const here = from('From here', () => this.#facing);
		this.sides = SIDES.map((label, side) => from(label, () => inward(side)));
		this.box = SIDES.map((label, side) => ruler(label, () => inward(side), (part, moving) => this.#trim(side, part, moving)));
		this.lens = toggle('A lens in the scan', (on) => this.#switch(on));
		this.size = slider('Size', { min: 0.05, max: 1, step: 0.01, change: (radius, moving) => this.#setLens({ radius: rounded(radius * this.#radius, 2) }, moving),
			text: (part) => `${Number((2 * part * this.#radius).toPrecision(3))} mm` });
		this.places = PLACES.map((label, axis) => ruler(label, () => inward(2 * axis), (part, moving) => this.#place(axis, part, moving)));
		this.looks = el('div');
		this.lensFields = el('div', {}, this.looks, this.size.element, ...this.places.map(({ element }) => element));
		this.note = el('p', { class: 'hint' });
		this.element = el('div', {},
			section('Cut it open', this.depth.element, el('div', { class: 'from', role: 'group', 'aria-label': 'Cut from' }, here, ...this.sides),
				el('p', { class: 'hint' }, 'Left and right are the patient’s.')),
			section('Box', el('div', { class: 'pair box', role: 'group', 'aria-label': 'Take away from' }, ...this.box.map(({ element }) => element)),
				el('p', {}, el('button', { type: 'button', class: 'quiet', onclick: () => {
					this.#normal = null;
					store.set({ plane: null, box: null });
				} }, 'Make it whole'))),
			section('Lens', this.lens.element, this.lensFields, this.note));
		this.setLooks([]);
		store.subscribe(() => this.show());
	}

	/** Away from the eye. */
	get #facing() {
		return short(scale(axes(this.store.state.camera).back, -1));
	}

	get #direction() {
		return this.#normal ?? this.#facing;
	}

	/** See {@link span}. @param {Vector} normal */
	#span(normal) {
		const volume = this.volume();
		return volume ? span(volume, normal) : [0, 0];
	}

	/** How much of the way through the scan lies before a point. @param {Vector} normal @param {Vector} point */
	#part(normal, point) {
		const [start, size] = this.#span(normal);
		return (dot(normal, point) - start) / size;
	}

	/** That of the plane. */
	get #depth() {
		const { plane } = this.store.state;
		return plane ? this.#part(plane.normal, plane.point) : 0;
	}

	/** Offers what presets show of the scan. @param {Offer[]} offers */
	setLooks(offers) {
		const looks = offers.flatMap(({ title, transfer }) => (transfer === null ? [] : [{ label: title, transfer }]));
		const options = [...SHOWS, ...looks.map(({ label, transfer }) => ({ value: told(transfer), label }))];
		this.shows = select('Shows', options, (value) => this.#setLens({ shows: looks.find(({ transfer }) => told(transfer) === value)?.transfer ?? value }));
		this.looks.replaceChildren(this.shows.element);
		this.show();
	}

	/** That of the scan's bounding sphere. */
	get #radius() {
		const volume = this.volume();
		return volume ? boundingSphere(volume).radius : 0;
	}

	/** Begins where the scan is nearest to the eye. @param {boolean} on */
	#switch(on) {
		const volume = this.volume();
		if (!volume) return;
		const { back } = axes(this.store.state.camera);
		const radius = rounded(0.3 * this.#radius, 2);
		const center = short(add(boundingSphere(volume).centre, scale(back, this.#span(back)[1] / 2 - radius)));
		this.store.set({ lens: on ? { center, radius, shows: 'fainter' } : null });
	}

	/** @param {Partial<Lens>} patch @param {boolean} [moving] */
	#setLens(patch, moving) {
		const { lens } = this.store.state;
		if (lens) this.store.set({ lens: { ...lens, ...patch } }, moving);
	}

	/** @param {number} axis @param {number} part of the way through the scan @param {boolean} moving */
	#place(axis, part, moving) {
		const [start, size] = this.#span(inward(2 * axis));
		const center = /** @type {Vector} */ (this.store.state.lens?.center.map((mm, n) => (n === axis ? rounded(start + part * size, 4) : mm)));
		this.#setLens({ center }, moving);
	}

	/** The plane in its middle, the sides of the box, the lens. @returns {Handle[]} */
	handles() {
		const { plane, box, lens } = this.store.state;
		const handle = (/** @type {Vector} */ at, /** @type {Vector} */ along, /** @type {(part: number, moving: boolean) => void} */ change) =>
			({ at, along, move: (/** @type {Vector} */ to, /** @type {boolean} */ moving) => change(this.#part(along, to), moving) });
		/** @type {Handle[]} */
		const handles = plane ? [handle(plane.point, plane.normal, (part, moving) => this.#cut(plane.normal, Math.max(0.005, Math.min(part, 1)), moving))] : [];
		if (box) SIDES.forEach((_, side) => {
			const middle = (/** @type {number} */ axis) => (box.min[axis] + box.max[axis]) / 2;
			const at = /** @type {Vector} */ ([0, 1, 2].map((axis) => (axis === side >> 1 ? box[side % 2 ? 'max' : 'min'][axis] : middle(axis))));
			handles.push(handle(at, inward(side), (part, moving) => this.#trim(side, Math.max(0, part), moving)));
		});
		if (lens) handles.push({ at: lens.center, along: null, move: (to, moving) => this.#setLens({ center: short(to) }, moving) });
		return handles;
	}

	/** @param {Vector} normal @param {number} part @param {boolean} [moving] */
	#cut(normal, part, moving) {
		const volume = this.volume();
		if (!volume) return;
		this.#normal = normal;
		const { centre } = boundingSphere(volume);
		const [start, size] = span(volume, normal);
		const point = short(add(centre, scale(normal, (start + part * size - dot(normal, centre)) / dot(normal, normal))));
		this.store.set({ plane: part > 0 ? { point, normal } : null }, moving);
	}

	/** @param {number} side @param {number} part @param {boolean} moving */
	#trim(side, part, moving) {
		const start = (/** @type {number} */ at) => inward(at)[at >> 1] * this.#span(inward(at))[0];
		const whole = { min: short([start(0), start(2), start(4)]), max: short([start(1), start(3), start(5)]) };
		const box = structuredClone(this.store.state.box ?? whole);
		const [axis, end, other] = /** @type {const} */ ([side >> 1, side % 2 ? 'max' : 'min', side % 2 ? 'min' : 'max']);
		const size = whole[other][axis] - whole[end][axis];
		// Something is left.
		const most = (box[other][axis] - whole[end][axis]) / size - 0.02;
		box[end][axis] = rounded(whole[end][axis] + Math.min(part, most) * size, 4);
		this.store.set({ box: JSON.stringify(box) === JSON.stringify(whole) ? null : box }, moving);
	}

	show() {
		const { plane, box, lens } = this.store.state;
		if (plane) this.#normal = plane.normal;
		this.depth.show(this.#depth);
		this.sides.forEach((button, side) => button.setAttribute('aria-pressed', String(plane !== null && String(plane.normal) === String(inward(side)))));
		this.box.forEach((control, side) => control.show(box ? this.#part(inward(side), side % 2 ? box.max : box.min) : 0));
		this.lens.show(lens !== null);
		this.lensFields.hidden = !lens;
		this.note.textContent = lens && !hasLens(this.store.state) ? 'Projections have no lens, and classified voxels no brightest values in one.' : '';
		if (!lens) return;
		this.shows?.show(told(lens.shows));
		this.size.show(lens.radius / (this.#radius || 1));
		this.places.forEach((control, axis) => control.show(this.#part(inward(2 * axis), lens.center)));
	}
}
