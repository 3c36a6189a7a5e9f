/** @file The panel of the view: camera, projection, blending, algorithm, quality. */
import { el } from './dom.js';
import { choice, numberField, section, select, slider, toggle } from './controls.js';
import { rendersHigh } from './frames.js';
import { keep, kept } from './page.js';
import { tidy } from './request.js';

/** @import {State, Store} from './state.js' */

const QUALITY_HINTS = {
	auto: 'Standard at rest, then high where that is fast.',
	draft: 'Coarse, for slow machines.',
	standard: 'Standard at rest.',
	high: 'High at rest, however long it takes.',
};

export class ViewPanel {
	/** @param {Store} store @param {import('./input.js').Input} input @param {import('./look.js').Look} look */
	constructor(store, input, look) {
		this.store = store;
		const set = (/** @type {Partial<State>} */ patch) => store.set(patch);
		this.projection = choice('Projection', [
			{ value: 'parallel', label: 'Parallel', hint: 'True to scale' },
			{ value: 'perspective', label: 'Perspective', hint: 'As an eye sees it' },
		], (projection) => store.setCamera({ projection }));
		this.fov = slider('Field of view', { min: 5, max: 120, step: 1, text: (v) => `${v}°`, change: (fov_y, moving) => store.setCamera({ fov_y }, moving) });
		this.angles = /** @type {const} */ (['azimuth', 'elevation', 'roll']).map((name) =>
			numberField(name[0].toUpperCase() + name.slice(1), { unit: '°', change: (value) => store.setCamera({ [name]: value }) }));
		this.zoom = numberField('Zoom', { min: 0.05, max: 200, change: (zoom) => store.setCamera({ zoom }) });
		this.upright = toggle('Keep upright', (on) => {
			input.upright = on;
			keep('upright', on ? 'yes' : 'no');
		}, 'Turning never tilts the scan');
		input.upright = kept('upright') === 'yes';
		this.upright.show(input.upright);
		this.blend = select('Blend', [
			{ value: 'composite', label: 'Composite: opacity and colour' },
			{ value: 'maximum', label: 'Maximum intensity' },
			{ value: 'minimum', label: 'Minimum intensity' },
			{ value: 'average', label: 'Average intensity' },
		], (blend) => set({ blend, window: look.firstWindow(blend) }));
		this.algorithm = select('Algorithm', [
			{ value: 'auto', label: 'Automatic' },
			{ value: 'preintegrated', label: 'Pre-integrated slabs' },
			{ value: 'classified', label: 'Classified, run lengths' },
			{ value: 'fast-classification', label: 'Classified, octree' },
			{ value: 'raycast', label: 'Ray casting (reference, slow)' },
		], (algorithm) => set({ algorithm }));
		this.quality = choice('Quality at rest', /** @type {State['quality'][]} */ (['auto', 'draft', 'standard', 'high']).map((value) =>
			({ value, label: value[0].toUpperCase() + value.slice(1), hint: QUALITY_HINTS[value] })), (quality) => set({ quality }));
		this.note = el('p', { class: 'hint' });
		this.element = el('div', {},
			section('Camera', this.projection.element, this.fov.element,
				el('div', { class: 'pair' }, this.angles[0].element, this.angles[1].element),
				el('div', { class: 'pair' }, this.angles[2].element, this.zoom.element), this.upright.element),
			section('Rendering', this.blend.element, this.algorithm.element, this.quality.element, this.note));
		store.subscribe(() => this.show());
		this.show();
	}

	show() {
		const { state } = this.store;
		const camera = tidy(state.camera);
		this.projection.show(camera.projection);
		this.fov.element.hidden = camera.projection === 'parallel';
		this.fov.show(camera.fov_y);
		[camera.azimuth, camera.elevation, camera.roll].forEach((angle, i) => this.angles[i].show(angle));
		this.zoom.show(camera.zoom);
		this.blend.show(state.blend);
		this.algorithm.show(state.algorithm);
		this.quality.show(state.quality);
		const high = rendersHigh(state);
		this.quality.enableOption('high', high);
		this.note.textContent = high ? `${QUALITY_HINTS[state.quality]} Drafts while you drag.` : 'This algorithm renders draft and standard only.';
	}
}
