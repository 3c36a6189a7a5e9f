/** @file The panel of light: shading, lamps, depth cueing, background. */
import { el } from './dom.js';
import { section, slider, toggle } from './controls.js';
import { DEFAULT_SHADING } from './state.js';
import { Lamps } from './lamps.js';

/** @import {Shading, Store} from './state.js' */

const COEFFICIENTS = /** @type {const} */ ([
	['ambient', 'Ambient', 1], ['diffuse', 'Diffuse', 1.5], ['specular', 'Highlights', 1], ['shininess', 'Sharpness of highlights', 100],
]);
const BACKGROUNDS = /** @type {const} */ ([
	['#000000', 'Black'], ['#20242b', 'Slate'], ['#8a929e', 'Grey'], ['#ffffff', 'White'], ['transparent', 'Transparent'],
]);

export class LightPanel {
	/** @param {Store} store @param {import('./look.js').Look} look */
	constructor(store, look) {
		this.store = store;
		this.look = look;
		this.on = toggle('Shade surfaces', (on) => store.set({ shading: on }), 'They catch light by their slope');
		this.sliders = COEFFICIENTS.map(([name, label, max]) => slider(label, {
			min: 0, max, step: max / 100, text: (value) => value.toFixed(max > 2 ? 0 : 2),
			change: (value, moving) => this.#change({ [name]: value }, moving),
		}));
		this.headlight = toggle('Headlight', (on) => this.#headlight(on), 'Shines from where you look');
		this.lamps = new Lamps(() => store.state.camera, (lights, moving) => this.#change({ lights }, moving));
		this.details = el('div', {}, ...this.sliders.map(({ element }) => element), this.headlight.element, this.lamps.element);
		this.cue = this.#depthCueing();
		this.background = this.#backgrounds();
		const lit = [section('Shading', this.on.element, this.details), section('Depth', this.cue.element)];
		this.element = el('div', {}, ...lit, section('Background', this.background.element));
		const show = () => {
			for (const part of lit) part.hidden = store.state.blend !== 'composite';
			this.show();
		};
		store.subscribe(show);
		look.onChange.push(show);
		show();
	}

	/** What frames are shaded with; `null`: not at all. @returns {Shading | null} */
	get #shading() {
		const { shading } = this.store.state;
		if (shading === null || shading === true) return shading || this.look.shaded ? DEFAULT_SHADING : null;
		return shading || null;
	}

	/** @param {Partial<Shading>} patch @param {boolean} [moving] */
	#change(patch, moving = false) {
		this.store.set({ shading: { ...(this.#shading ?? DEFAULT_SHADING), ...patch } }, moving);
	}

	/** @param {boolean} on */
	#headlight(on) {
		const others = (this.#shading ?? DEFAULT_SHADING).lights.filter((light) => light !== 'headlight');
		this.#change({ lights: on ? ['headlight', ...others] : others });
	}

	#depthCueing() {
		const { store } = this;
		const now = () => store.state.depthCueing ?? { front: 1, density: 1 };
		const on = toggle('Fade with depth', (yes) => store.set({ depthCueing: yes ? now() : null }), 'What lies behind is darker');
		const part = (/** @type {string} */ label, /** @type {'density' | 'front'} */ name, /** @type {number} */ max) => slider(label, {
			min: 0, max, step: 0.05, text: (value) => value.toFixed(2),
			change: (value, moving) => store.set({ depthCueing: { ...now(), [name]: value } }, moving),
		});
		const [density, front] = [part('Fading', 'density', 4), part('Brightness in front', 'front', 2)];
		const more = el('div', {}, density.element, front.element);
		return { element: el('div', {}, on.element, more), on, density, front, more };
	}

	#backgrounds() {
		const { store } = this;
		const swatches = BACKGROUNDS.map(([value, label]) =>
			el('button', { type: 'button', class: 'swatch', 'aria-label': label, title: label, 'data-color': value, onclick: () => store.set({ background: value }) }));
		for (const swatch of swatches) swatch.style.backgroundColor = String(swatch.dataset.color);
		const own = el('input', {
			type: 'color', 'aria-label': 'Another colour', title: 'Another colour',
			oninput: () => store.set({ background: own.value }, true), onchange: () => store.set({ background: own.value }),
		});
		return { element: el('div', { class: 'swatches' }, ...swatches, own), swatches, own };
	}

	show() {
		const { state } = this.store;
		const shading = this.#shading;
		this.on.show(shading !== null);
		this.details.hidden = shading === null;
		const shown = shading ?? DEFAULT_SHADING;
		COEFFICIENTS.forEach(([name], i) => this.sliders[i].show(shown[name]));
		this.headlight.show(shown.lights.includes('headlight'));
		this.lamps.show(shown.lights);
		this.cue.on.show(state.depthCueing !== null);
		this.cue.more.hidden = state.depthCueing === null;
		this.cue.density.show(state.depthCueing?.density ?? 1);
		this.cue.front.show(state.depthCueing?.front ?? 1);
		for (const swatch of this.background.swatches) swatch.setAttribute('aria-pressed', String(swatch.dataset.color === state.background));
		if (state.background !== 'transparent') this.background.own.value = state.background;
	}
}
