/** @file Looks to choose from, each with a picture of this scan in it. */
import { el } from './dom.js';
import { writeTransfer } from './link.js';
import { looksFor } from './looks.js';
import { emptyImage } from './thumbnails.js';

/** @import {Preset, ReadyVolume, Fitted} from './api.js' */
/** @import {Offer} from './looks.js' */

/** A look as its link says it. @param {Offer['transfer']} transfer */
const written = (transfer) => (transfer === null || typeof transfer === 'string' ? transfer : writeTransfer(transfer));

export class PresetList {
	/** @type {Preset[]} */ #presets = [];
	/** @type {{button: HTMLElement, transfer: string | null}[]} */ #buttons = [];

	/** @param {import('./state.js').Store} store @param {import('./thumbnails.js').Thumbnails} thumbnails */
	constructor(store, thumbnails) {
		this.store = store;
		this.thumbnails = thumbnails;
		this.fitting = el('div', { class: 'presets' });
		this.others = el('div', { class: 'presets' });
		this.more = el('details', { class: 'more', ontoggle: () => thumbnails.wake() }, el('summary', {}, 'For other kinds of scans'), this.others);
		this.more.hidden = true;
		this.element = el('div', { role: 'group', 'aria-label': 'Presets' }, this.fitting, this.more);
		store.subscribe((state, before) => state.transfer !== before.transfer && this.#mark());
	}

	/** @param {Preset[]} presets */
	setPresets(presets) {
		this.#presets = presets;
	}

	/** Gives those that fit it. @param {ReadyVolume} volume @param {Fitted | null} automatic its own look, where that is none of the presets */
	setVolume(volume, automatic) {
		const { fitting, others } = looksFor(this.#presets, volume, automatic);
		this.#buttons = [];
		// Which kind of scan they are for goes without saying where it is this kind.
		this.fitting.replaceChildren(...fitting.map((offer) => this.#button(offer, volume, offer.title.replace(/ \(.*\)$/, ''))));
		this.others.replaceChildren(...others.map((offer) => this.#button(offer, volume, offer.title)));
		this.more.hidden = others.length === 0;
		this.#mark();
		return fitting;
	}

	/** @param {Offer} offer @param {ReadyVolume} volume @param {string} label */
	#button({ name, title, description, transfer, shading }, volume, label) {
		const image = emptyImage();
		this.thumbnails.fill(image, volume.id, transfer, shading);
		const onclick = () => this.store.set({ transfer, shading });
		const button = el('button', { type: 'button', class: 'preset', title: `${title}: ${description}`, 'data-name': name, onclick }, image, el('span', {}, label));
		this.#buttons.push({ button, transfer: written(transfer) });
		return button;
	}

	#mark() {
		const now = written(this.store.state.transfer);
		for (const { button, transfer } of this.#buttons) button.setAttribute('aria-pressed', String(transfer === now));
	}
}
