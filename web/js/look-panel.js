/** @file The panel of the transfer function: presets, editor, the point in hand, window and density. */
import { el, iconButton } from './dom.js';
import { numberField, section, slider } from './controls.js';
import { short, withChanged } from './transfer.js';

/** @import {Look} from './look.js' */
/** @import {TransferEditor} from './transfer-editor.js' */

/** Times the preset's density, at most and at least. */
const DENSITY = 30;

export class LookPanel {
	/** The opacity distance that density 1 stands for: that of the last preset, or of the link; 0 before. */
	#reference = 0;

	/** @param {import('./state.js').Store} store @param {Look} look @param {TransferEditor} editor @param {Node} presets */
	constructor(store, look, editor, presets) {
		this.store = store;
		this.look = look;
		this.editor = editor;
		this.undo = iconButton('undo', 'Undo (Ctrl+Z)', () => look.undo());
		this.redo = iconButton('redo', 'Redo (Ctrl+Shift+Z)', () => look.redo());
		const bar = el('div', { class: 'bar' }, this.undo, this.redo, el('span', { class: 'spacer' }),
			iconButton('plus', 'Add a point', () => editor.addHere()),
			iconButton('fit-points', 'Show the values that the points lie on', () => editor.showPoints()),
			iconButton('fit-all', 'Show all values', () => editor.showAll()));
		this.point = this.#pointFields();
		this.window = this.#windowFields();
		this.hint = el('p', { class: 'hint' }, 'Click to add a point, drag to move it, right-click or Delete to remove it. Drag beside the points to shift or stretch all of them. Ctrl + wheel or a pinch enlarges the axis.');
		const points = section('Transfer function', bar, editor.element, this.point.element, this.hint);
		const composite = el('div', {}, section('Presets', presets), points);
		const note = el('p', { class: 'hint' }, 'A projection shows values from black to white: presets and points do not matter to it. Drag with the right button, or with the last tool below the picture, to change the window.');
		this.element = el('div', {}, composite, note, section('Window', this.window.element));
		const show = () => {
			composite.hidden = store.state.blend !== 'composite';
			note.hidden = !composite.hidden;
			this.show();
		};
		store.subscribe(show);
		look.onChange.push(show);
		editor.onSelect = () => this.#showPoint();
		show();
	}

	#pointFields() {
		const change = (/** @type {Partial<import('./state.js').ControlPoint>} */ patch, moving = false) => {
			const { look, editor } = this;
			if (look.current && editor.selected >= 0) look.edit(withChanged(look.current, editor.selected, patch), moving);
		};
		const value = numberField('Value', { change: (now) => change({ value: now }) });
		const opacity = numberField('Opacity', { min: 0, max: 1, change: (now) => change({ opacity: now }) });
		const color = el('input', {
			type: 'color', 'aria-label': 'Colour of the point',
			oninput: () => change({ color: color.value }, true), onchange: () => this.look.commit(),
		});
		const remove = iconButton('trash', 'Remove the point', () => this.editor.remove());
		const element = el('div', { class: 'point-fields' }, value.element, opacity.element, color, remove);
		return { element, value, opacity, color, remove };
	}

	#windowFields() {
		const { look } = this;
		const change = (/** @type {Partial<import('./state.js').Window>} */ patch) => {
			const now = look.window;
			if (now) look.setWindow({ ...now, ...patch });
		};
		const center = numberField('Level', { change: (now) => change({ center: now }) });
		const width = numberField('Width', { min: 0, change: (now) => change({ width: now }) });
		const density = slider('Density', {
			min: -1, max: 1, step: 0.01,
			position: (times) => Math.log(times) / Math.log(DENSITY),
			value: (at) => DENSITY ** at,
			text: (times) => `× ${times < 10 ? times.toFixed(2) : times.toFixed(0)}`,
			change: (times, moving) => this.#setDensity(times, moving),
		});
		const element = el('div', {}, el('div', { class: 'pair' }, center.element, width.element), density.element);
		return { element, center, width, density };
	}

	/** @param {number} times @param {boolean} moving */
	#setDensity(times, moving) {
		const { current } = this.look;
		if (!current) return;
		// The slider's end of a drag brings the value that it already has.
		const opacity_distance = Number((this.#reference / times).toPrecision(4));
		if (opacity_distance !== current.opacity_distance) this.look.edit({ ...current, opacity_distance }, moving);
		if (!moving) this.look.commit();
	}

	show() {
		const { look, store: { state: { transfer, blend } } } = this;
		this.undo.disabled = !look.canUndo;
		this.redo.disabled = !look.canRedo;
		const { center, width, density } = this.window;
		const window = look.window;
		if (window) {
			center.show(short(window.center, window.width));
			width.show(short(window.width, window.width));
		}
		const distance = look.current?.opacity_distance;
		if (distance && (!this.#reference || transfer === null || typeof transfer === 'string')) this.#reference = distance;
		density.element.hidden = blend !== 'composite';
		density.element.inert = distance === undefined;
		if (distance) density.show(this.#reference / distance);
		this.#showPoint();
	}

	#showPoint() {
		const { editor, look } = this;
		const point = look.current?.points[editor.selected];
		this.point.element.hidden = !point;
		if (!point) return;
		this.point.value.show(point.value);
		this.point.opacity.show(point.opacity);
		this.point.color.value = point.color.toLowerCase();
		this.point.remove.disabled = (look.current?.points.length ?? 0) < 2;
	}
}
