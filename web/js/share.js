/** @file What leaves the viewer: a link, a command, a picture or a turn of it. */
import { Problem, frame } from './api.js';
import { el } from './dom.js';
import { numberField, toggle, choice } from './controls.js';
import { rendersHigh } from './frames.js';
import { toHash } from './link.js';
import { curlCommand, renderRequest } from './request.js';
import { turntable } from './turntable.js';

/** @import {Size} from './request.js' */
/** @typedef {'standard' | 'high'} Quality */
/** @typedef {Size & {transparent: boolean, quality: Quality, what: 'picture' | 'turntable', frames: number, seconds: number}} Wanted */

export class Share {
	/** @param {import('./state.js').Store} store @param {() => Size} size of the picture @param {import('./messages.js').Messages} messages @param {HTMLDialogElement} dialog */
	constructor(store, size, messages, dialog) {
		this.store = store;
		this.size = size;
		this.messages = messages;
		this.dialog = dialog;
	}

	/** That of the picture at rest; where it is left to the service's speed, what is always fast. @returns {'draft' | 'standard' | 'high'} */
	get #quality() {
		const { quality } = this.store.state;
		return quality === 'auto' || (quality === 'high' && !rendersHigh(this.store.state)) ? 'standard' : quality;
	}

	copyLink() {
		this.#copy('Link', new URL(toHash(this.store.state), location.href).href);
	}

	copyCurl() {
		this.#copy('Command', curlCommand(this.store.state, this.size(), this.#quality, location.href));
	}

	/** Browsers give pages of plain HTTP no clipboard, except on this machine: then the text is shown to be copied by hand. @param {string} what @param {string} text */
	async #copy(what, text) {
		try {
			await navigator.clipboard.writeText(text);
			this.messages.say(`${what} copied.`);
		} catch {
			const field = el('textarea', { readonly: true, rows: 6, 'aria-label': what }, text);
			this.#open(`${what} to copy`, field, this.#closing('Close'));
			field.select();
		}
	}

	/** @param {string} title @param {Node[]} content */
	#open(title, ...content) {
		this.dialog.replaceChildren(el('form', { method: 'dialog' }, el('h2', { id: 'dialog-title' }, title), ...content));
		this.dialog.showModal();
	}

	/** @param {string} label */
	#closing = (label) => el('div', { class: 'buttons' }, el('button', { class: 'quiet' }, label));

	/** Asks for a size, renders at it, and gives the browser a file to keep. */
	savePicture() {
		/** @type {Wanted} */
		const wanted = { ...this.size(), transparent: false, quality: this.#quality === 'high' ? 'high' : 'standard', what: 'picture', frames: 90, seconds: 6 };
		const what = choice('What', [
			{ value: 'picture', label: 'Picture', hint: 'As it is seen' },
			{ value: 'turntable', label: 'Turntable', hint: 'Once about the vertical axis, as an animated PNG' },
		], (value) => {
			wanted.what = value;
			turn.hidden = value === 'picture';
		});
		what.show(wanted.what);
		const field = (/** @type {string} */ label, /** @type {'width' | 'height' | 'frames' | 'seconds'} */ name, /** @type {object} */ limits) => {
			const control = numberField(label, { ...limits, change: (value) => (wanted[name] = value) });
			control.show(wanted[name]);
			return control.element;
		};
		const side = { min: 1, max: 4096, step: 1, unit: 'px' };
		const size = el('div', { class: 'pair' }, field('Width', 'width', side), field('Height', 'height', side));
		const turn = el('div', { class: 'pair', hidden: true }, field('Frames', 'frames', { min: 2, max: 720, step: 1 }),
			field('Duration', 'seconds', { min: 0.1, max: 60, unit: 's' }));
		const ground = toggle('Transparent background', (on) => (wanted.transparent = on));
		const quality = choice('Quality', /** @type {Quality[]} */ (['standard', 'high']).map((value) => ({ value, label: value })), (value) => (wanted.quality = value));
		quality.show(wanted.quality);
		quality.enableOption('high', rendersHigh(this.store.state));
		const bar = el('progress', { hidden: true, 'aria-label': 'Frames rendered' });
		const progress = el('p', { class: 'hint', role: 'status' });
		const abort = new AbortController();
		const save = el('button', { type: 'button', class: 'primary', onclick: async () => {
			save.disabled = true;
			progress.textContent = 'Rendering…';
			const failed = await this.#save({ ...wanted }, (done) => {
				bar.hidden = false;
				[bar.max, bar.value] = [wanted.frames, done];
			}, abort.signal);
			save.disabled = false;
			bar.hidden = true;
			progress.textContent = failed ?? '';
			if (!failed && !abort.signal.aborted) this.dialog.close();
		} }, 'Save');
		this.dialog.addEventListener('close', () => abort.abort(), { once: true });
		this.#open('Save', what.element, size, turn, quality.element, ground.element, bar, progress,
			el('div', { class: 'buttons' }, el('button', { class: 'quiet' }, 'Cancel'), save));
	}

	/** @param {Wanted} wanted @param {(done: number) => void} progress of a turntable @param {AbortSignal} signal @returns {Promise<string | null>} why not */
	async #save({ width, height, transparent, quality, what, ...turn }, progress, signal) {
		const { state } = this.store;
		const shown = { ...state, background: transparent ? 'transparent' : state.background };
		const size = { width, height };
		try {
			const blob = what === 'turntable' ? await turntable(shown, size, quality, turn, progress, signal)
				: (await frame(state.volume, renderRequest(shown, size, quality), signal)).blob;
			const href = URL.createObjectURL(blob);
			el('a', { href, download: `${state.volume}${what === 'turntable' ? '-turntable' : ''}.png` }).click();
			setTimeout(() => URL.revokeObjectURL(href), 10_000);
			this.messages.say(what === 'turntable' ? 'Turntable saved.' : 'Picture saved.');
			return null;
		} catch (error) {
			if (signal.aborted) return null;
			return error instanceof Problem ? [error.message, ...error.errors.map(({ detail }) => detail)].join(' ') : String(error);
		}
	}

	/** What keys and pointers do. */
	help() {
		/** @type {[string, string][]} */
		const rows = [
			['Drag, arrow keys', 'Turn'],
			['Shift + drag, middle button, Shift + arrows', 'Move'],
			['Wheel, pinch, + and −', 'Zoom'],
			['Alt + drag, two fingers, [ and ]', 'Roll'],
			['Right button, Ctrl + drag', 'Window: sideways the width, up and down the level'],
			['A P L R S I', 'Look from anterior, posterior, left, right, superior, inferior'],
			['0, double click', 'The whole scan'],
			['Ctrl + Z, Ctrl + Shift + Z', 'Undo, redo the transfer function'],
		];
		this.#open('Help', el('dl', { class: 'facts wide' }, ...rows.map(([keys, what]) => el('div', {}, el('dt', {}, keys), el('dd', {}, what)))),
			el('p', { class: 'hint' }, 'Keys work while the picture has the focus. ', el('a', { href: 'openapi.yaml' }, 'The interface for programs'), '.'), this.#closing('Close'));
	}
}
