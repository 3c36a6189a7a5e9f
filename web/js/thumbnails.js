/**
 * @file Small still frames for lists, one after another, and only while the picture itself needs nothing.
 *
 * A list of scans would otherwise ask for as many frames at once as there are scans, just when a person starts to turn one.
 */
import { Problem, thumbnail } from './api.js';

/** Pixels along a side: twice what is shown, for fine screens. */
const SIDE = 160;
/** Milliseconds between two looks at whether the picture rests. */
const PAUSE = 150;

/** @typedef {{id: string, preset: string | null, image: HTMLImageElement}} Wish */

export class Thumbnails {
  /** Object URLs by scan and preset. @type {Map<string, string>} */ #made = new Map();
  /** @type {Wish[]} */ #wishes = [];
  #working = false;

  /** @param {() => boolean} idle whether the picture rests */
  constructor(idle) {
    this.idle = idle;
  }

  /** Fills `image` when there is time; images that have left the page are passed over. @param {HTMLImageElement} image @param {string} id @param {string | null} preset */
  fill(image, id, preset) {
    const made = this.#made.get(key(id, preset));
    if (made) image.src = made;
    else this.#wishes.push({ id, preset, image });
    this.#work();
  }

  async #work() {
    if (this.#working) return;
    this.#working = true;
    while (this.#wishes.length > 0) {
      await new Promise((resolve) => setTimeout(resolve, this.idle() ? 0 : PAUSE));
      if (document.hidden || !this.idle()) continue;
      // The first that is in sight; those in closed tabs and drawers wait.
      this.#wishes = this.#wishes.filter(({ image }) => image.isConnected);
      const next = this.#wishes.findIndex(({ image }) => image.checkVisibility());
      if (next < 0) break;
      await this.#grant(this.#wishes.splice(next, 1)[0]);
    }
    this.#working = false;
  }

  /** Looks again for images that have come into sight. */
  wake() {
    this.#work();
  }

  /** @param {Wish} wish */
  async #grant({ id, preset, image }) {
    const query = { width: String(SIDE), height: String(SIDE), azimuth: '30', elevation: '15', zoom: '1.4', quality: 'draft' };
    try {
      const blob = await thumbnail(id, { ...query, ...(preset ? { preset } : {}) }, AbortSignal.timeout(20_000));
      const url = URL.createObjectURL(blob);
      this.#made.set(key(id, preset), url);
      image.src = url;
    } catch (error) {
      // Busy or gone: it is a decoration, and comes later. Anything else will not get better.
      if (!(error instanceof Problem) || !error.passing) return;
      this.#wishes.push({ id, preset, image });
      await new Promise((resolve) => setTimeout(resolve, 1000 * error.retryAfter));
    }
  }
}

/** @param {string} id @param {string | null} preset */
const key = (id, preset) => `${id}\n${preset ?? ''}`;

/** An empty image that a {@link Thumbnails} may fill. */
export function emptyImage() {
  const image = new Image(SIDE / 2, SIDE / 2);
  image.alt = '';
  return image;
}
