/** @file The panel of scans: what there is, and what is known about the one in sight. */
import { el } from './dom.js';
import { section } from './controls.js';
import { emptyImage } from './thumbnails.js';

/** @import {Volume} from './api.js' */

export class ScanPanel {
	/** @param {import('./state.js').Store} store @param {import('./thumbnails.js').Thumbnails} thumbnails @param {(id: string) => void} open */
	constructor(store, thumbnails, open) {
		this.store = store;
		this.thumbnails = thumbnails;
		this.open = open;
		this.list = el('ul', { class: 'scans' });
		this.facts = el('dl', { class: 'facts' });
		this.about = section('About this scan', this.facts);
		this.element = el('div', {}, section('Scans', this.list), this.about);
	}

	/** @param {Volume[]} volumes */
	show(volumes) {
		const kept = new Map([...this.list.children].map((item) => [item.getAttribute('data-key'), item]));
		// Items whose scan did not change keep their pictures.
		this.list.replaceChildren(...volumes.map((volume) => kept.get(`${volume.id} ${volume.status}`) ?? this.#item(volume)));
		for (const button of this.list.querySelectorAll('button'))
			button.setAttribute('aria-current', String(button.dataset.id === this.store.state.volume));
		this.#describe(volumes.find(({ id }) => id === this.store.state.volume));
	}

	/** @param {Volume} volume */
	#item(volume) {
		const { id, name, status, modality, dimensions, detail } = volume;
		const image = emptyImage();
		const line = status === 'ready' ? [modality, dimensions?.join(' × ')].filter(Boolean).join(' · ')
			: status === 'loading' ? 'Being loaded…' : `Could not be loaded: ${detail ?? 'unknown reason'}`;
		if (status === 'ready') this.thumbnails.fill(image, id);
		const words = el('span', {}, el('strong', {}, name), el('small', {}, line));
		const button = el('button', { type: 'button', 'data-id': id, disabled: status !== 'ready', onclick: () => this.open(id) }, image, words);
		return el('li', { class: status, 'data-key': `${id} ${status}` }, button);
	}

	/** @param {Volume | undefined} volume */
	#describe(volume) {
		this.about.hidden = volume?.status !== 'ready';
		if (!volume?.dimensions || !volume.spacing || !volume.value_range || !volume.import || !volume.bytes) return;
		const mm = volume.dimensions.map((n, i) => ((n - 1) * /** @type {number[]} */ (volume.spacing)[i]).toFixed(0));
		const { format, non_finite, quantized, volumes_left_out } = volume.import;
		const notes = [
			quantized && 'mapped to 16 bits', non_finite > 0 && `${non_finite} values that were no numbers`,
			volumes_left_out > 0 && `${volumes_left_out} more volumes in the file`,
		].filter(Boolean);
		const bytes = Object.values(volume.bytes).reduce((sum, n) => sum + n, 0);
		/** @type {[string, string | undefined][]} */
		const facts = [
			['Kind', volume.modality],
			['Voxels', volume.dimensions.join(' × ')],
			['Spacing', `${volume.spacing.map((s) => Number(s.toFixed(3))).join(' × ')} mm`],
			['Extent', `${mm.join(' × ')} mm`],
			['Values', `${volume.value_range.map((v) => Number(v.toPrecision(6)).toLocaleString('en')).join(' to ')} (${volume.scalar_type})`],
			['Default look', volume.default_preset],
			['Format', format],
			['In memory', `${(bytes / 1e6).toFixed(0)} MB`],
			['On import', notes.join('; ') || undefined],
		];
		const shown = facts.filter(([, value]) => value);
		this.facts.replaceChildren(...shown.map(([term, value]) => el('div', {}, el('dt', {}, term), el('dd', {}, value ?? ''))));
	}
}
