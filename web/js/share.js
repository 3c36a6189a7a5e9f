/** @file What leaves the viewer: a link, a command, a picture. */
import { Problem, frame } from './api.js';
import { el } from './dom.js';
import { numberField, toggle, choice } from './controls.js';
import { rendersHigh } from './frames.js';
import { toHash } from './link.js';
import { curlCommand, renderRequest } from './request.js';

/** @typedef {import('./request.js').Size} Size */
/** @typedef {'standard' | 'high'} Quality */

export class Share {
  /**
   * @param {import('./state.js').Store} store @param {() => Size} size of the picture
   * @param {import('./messages.js').Messages} messages @param {HTMLDialogElement} dialog
   */
  constructor(store, size, messages, dialog) {
    this.store = store;
    this.size = size;
    this.messages = messages;
    this.dialog = dialog;
  }

  copyLink() {
    this.#copy('Link', new URL(toHash(this.store.state), location.href).href);
  }

  copyCurl() {
    this.#copy('Command', curlCommand(this.store.state, this.size(), 'standard', location.href));
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
    const wanted = { ...this.size(), transparent: false, quality: /** @type {Quality} */ ('standard') };
    const limits = { min: 1, max: 4096, step: /** @type {const} */ (1), unit: 'px' };
    const width = numberField('Width', { ...limits, change: (value) => (wanted.width = value) });
    const height = numberField('Height', { ...limits, change: (value) => (wanted.height = value) });
    width.show(wanted.width);
    height.show(wanted.height);
    const ground = toggle('Transparent background', (on) => (wanted.transparent = on));
    const quality = choice('Quality', /** @type {Quality[]} */ (['standard', 'high']).map((value) => ({ value, label: value })), (value) => (wanted.quality = value));
    quality.show('standard');
    quality.enableOption('high', rendersHigh(this.store.state));
    const progress = el('p', { class: 'hint', role: 'status' });
    const abort = new AbortController();
    const save = el('button', { type: 'button', class: 'primary', onclick: async () => {
      save.disabled = true;
      progress.textContent = 'Rendering…';
      const failed = await this.#save(wanted, abort.signal);
      save.disabled = false;
      progress.textContent = failed ?? '';
      if (!failed) this.dialog.close();
    } }, 'Save');
    this.dialog.addEventListener('close', () => abort.abort(), { once: true });
    this.#open('Save the picture', el('div', { class: 'pair' }, width.element, height.element), quality.element, ground.element, progress,
      el('div', { class: 'buttons' }, el('button', { class: 'quiet' }, 'Cancel'), save));
  }

  /** @param {Size & {transparent: boolean, quality: Quality}} wanted @param {AbortSignal} signal @returns {Promise<string | null>} why not */
  async #save({ width, height, transparent, quality }, signal) {
    const { state } = this.store;
    const background = transparent ? 'transparent' : state.background;
    try {
      const { blob } = await frame(state.volume, renderRequest({ ...state, background }, { width, height }, quality), signal);
      const href = URL.createObjectURL(blob);
      el('a', { href, download: `${state.volume}.png` }).click();
      setTimeout(() => URL.revokeObjectURL(href), 10_000);
      this.messages.say('Picture saved.');
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
