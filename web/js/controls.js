/**
 * @file Labelled controls: sliders, switches, choices, numbers.
 * Each gives its element and `show`, which sets what it displays without calling back.
 */
import { el } from './dom.js';

/** @template T @typedef {{element: HTMLElement, show: (value: T) => void}} Control */
/** @template {string} T @typedef {{value: T, label: string, hint?: string}} Option */

let count = 0;
const nextId = () => `control-${++count}`;

/**
 * @param {string} label
 * @param {object} options
 * @param {number} options.min @param {number} options.max
 * @param {number} [options.step] of the slider's own scale
 * @param {(value: number) => number} [options.position] from the value to the slider's scale
 * @param {(position: number) => number} [options.value] and back
 * @param {(value: number) => string} [options.text]
 * @param {(value: number, moving: boolean) => void} options.change
 * @returns {Control<number>}
 */
export function slider(label, { min, max, step = (max - min) / 200, position = (v) => v, value = (p) => p, text = String, change }) {
	const id = nextId();
	const output = el('output', { for: id });
	const told = (/** @type {boolean} */ moving) => {
		const now = value(Number(input.value));
		describe(now);
		change(now, moving);
	};
	const input = el('input', { type: 'range', id, min, max, step, oninput: () => told(true), onchange: () => told(false) });
	const describe = (/** @type {number} */ now) => {
		output.textContent = text(now);
		input.setAttribute('aria-valuetext', text(now));
	};
	const show = (/** @type {number} */ now) => {
		input.value = String(position(now));
		describe(now);
	};
	const element = el('div', { class: 'field slider' }, el('label', { for: id }, label), output, input);
	return { element, show };
}

/**
 * @param {string} label
 * @param {object} options
 * @param {number} [options.min] @param {number} [options.max]
 * @param {number | 'any'} [options.step] @param {string} [options.unit]
 * @param {(value: number) => void} options.change
 * @returns {Control<number>}
 */
export function numberField(label, { min, max, step = 'any', unit, change }) {
	const id = nextId();
	const onchange = () => input.value !== '' && input.checkValidity() && change(Number(input.value));
	const input = el('input', { type: 'number', id, min, max, step, inputmode: 'decimal', onchange });
	const element = el('div', { class: 'field number' }, el('label', { for: id }, label), input, ...(unit ? [el('span', { class: 'unit' }, unit)] : []));
	const show = (/** @type {number} */ value) => {
		// Not while a person types into it.
		if (document.activeElement !== input || !input.matches(':focus-visible') || Number(input.value) !== value) input.value = String(Number(value.toPrecision(6)));
	};
	return { element, show };
}

/** @param {string} label @param {(on: boolean) => void} change @param {string} [hint] @returns {Control<boolean>} */
export function toggle(label, change, hint) {
	const input = el('input', { type: 'checkbox', role: 'switch', onchange: () => change(input.checked) });
	const words = el('span', {}, label, ...(hint ? [el('small', {}, hint)] : []));
	const element = el('label', { class: 'field switch' }, words, input);
	return { element, show: (on) => void (input.checked = on) };
}

/**
 * One of a few, all in sight.
 * @template {string} T
 * @param {string} label @param {Option<T>[]} options @param {(value: T) => void} change
 * @returns {Control<T> & {enableOption: (value: T, enabled: boolean) => void}}
 */
export function choice(label, options, change) {
	const name = nextId();
	const inputs = options.map(({ value }) => el('input', { type: 'radio', name, value, onchange: () => change(value) }));
	const parts = options.map((option, i) => el('label', { title: option.hint }, inputs[i], el('span', {}, option.label)));
	const element = el('fieldset', { class: 'field choice' }, el('legend', {}, label), el('div', { class: 'segments' }, ...parts));
	const at = (/** @type {T} */ value) => inputs[options.findIndex((option) => option.value === value)];
	return {
		element,
		show: (value) => {
			const input = at(value);
			if (input) input.checked = true;
		},
		enableOption: (value, enabled) => void (at(value).disabled = !enabled),
	};
}

/** One of many. @template {string} T @param {string} label @param {Option<T>[]} options @param {(value: T) => void} change @returns {Control<T>} */
export function select(label, options, change) {
	const id = nextId();
	const onchange = () => change(/** @type {T} */ (input.value));
	const input = el('select', { id, onchange }, ...options.map(({ value, label: text }) => el('option', { value }, text)));
	const element = el('div', { class: 'field select' }, el('label', { for: id }, label), input);
	return { element, show: (value) => void (input.value = value) };
}

/** @param {string} title @param {(Node | string)[]} children */
export const section = (title, ...children) => el('section', {}, el('h2', {}, title), ...children);
