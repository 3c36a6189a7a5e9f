/** @file Looks to choose from, each with a picture of this scan in it. */
import { el } from './dom.js';
import { emptyImage } from './thumbnails.js';

/** @typedef {import('./api.js').Preset} Preset */
/** @typedef {import('./api.js').Volume} Volume */

/** Whether a preset is meant for such a scan, as far as the scan says what it is. @param {Preset} preset @param {Volume} volume */
function fits({ name, modality }, volume) {
  const words = `${volume.modality ?? ''} ${(volume.default_preset ?? '').slice(0, 3)}`.toUpperCase();
  const known = /CT|MR/.test(words);
  return name === volume.default_preset || modality.length === 0 || !known || modality.some((word) => words.includes(word));
}

export class PresetList {
  /** @type {Preset[]} */ #presets = [];

  /**
   * @param {import('./state.js').Store} store
   * @param {import('./thumbnails.js').Thumbnails} thumbnails
   */
  constructor(store, thumbnails) {
    this.store = store;
    this.thumbnails = thumbnails;
    this.fitting = el('div', { class: 'presets' });
    this.others = el('div', { class: 'presets' });
    this.more = el('details', { class: 'more', ontoggle: () => thumbnails.wake() }, el('summary', {}, 'For other kinds of scans'), this.others);
    this.element = el('div', { role: 'group', 'aria-label': 'Presets' }, this.fitting, this.more);
    store.subscribe((state, before) => state.transfer !== before.transfer && this.#mark());
  }

  /** @param {Preset[]} presets */
  setPresets(presets) {
    this.#presets = presets;
  }

  /** @param {Volume} volume a ready one */
  setVolume(volume) {
    const automatic = { name: '', title: 'Automatic', description: 'What suits this scan, by its kind and its histogram.' };
    const wanted = this.#presets.filter((preset) => fits(preset, volume));
    const rest = this.#presets.filter((preset) => !wanted.includes(preset));
    this.fitting.replaceChildren(...[automatic, ...wanted].map((preset) => this.#button(preset, volume)));
    this.others.replaceChildren(...rest.map((preset) => this.#button(preset, volume)));
    this.more.hidden = rest.length === 0;
    this.#mark();
  }

  /** @param {Pick<Preset, 'name' | 'title' | 'description'>} preset @param {Volume} volume */
  #button({ name, title, description }, volume) {
    const image = emptyImage();
    this.thumbnails.fill(image, volume.id, name || null);
    const onclick = () => this.store.set({ transfer: name || null, shading: null });
    return el('button', { type: 'button', class: 'preset', title: description, 'data-name': name, onclick }, image, el('span', {}, title));
  }

  #mark() {
    const { transfer } = this.store.state;
    for (const button of this.element.querySelectorAll('button')) {
      const pressed = transfer === null ? button.dataset.name === '' : button.dataset.name === transfer;
      button.setAttribute('aria-pressed', String(pressed));
    }
  }
}
