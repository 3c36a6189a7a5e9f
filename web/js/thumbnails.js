/** @file Small still frames for lists, one after another, and only while the picture itself needs nothing. */
import { Problem, frame, thumbnail } from './api.js';

/** Pixels along a side: twice what is shown, for fine screens. */
const SIDE = 160;
const CAMERA = { azimuth: 30, elevation: 15, zoom: 1.4 };
/** Milliseconds between two looks at whether the picture rests. */
const PAUSE = 150;

/** @import {State} from './state.js' */
/** @typedef {{id: string, transfer: State['transfer'], shading: State['shading'], image: HTMLImageElement}} Wish */

export class Thumbnails {
	/** Object URLs by scan and look. @type {Map<string, string>} */ #made = new Map();
	/** @type {Wish[]} */ #wishes = [];
	#working = false;

	/** @param {() => boolean} idle whether the picture rests */
	constructor(idle) {
		this.idle = idle;
	}

	/** Fills `image` when there is time; images that have left the page are passed over. @param {HTMLImageElement} image @param {string} id @param {State['transfer']} [transfer] @param {State['shading']} [shading] */
	fill(image, id, transfer = null, shading = null) {
		const made = this.#made.get(key(id, transfer));
		if (made) image.src = made;
		else this.#wishes.push({ id, transfer, shading, image });
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
	async #grant(wish) {
		const { id, transfer, image } = wish;
		try {
			const url = URL.createObjectURL(await rendered(wish, AbortSignal.timeout(20_000)));
			this.#made.set(key(id, transfer), url);
			image.src = url;
		} catch (error) {
			// Busy or gone: it is a decoration, and comes later. Anything else will not get better.
			if (!(error instanceof Problem) || !error.passing) return;
			this.#wishes.push(wish);
			await new Promise((resolve) => setTimeout(resolve, 1000 * error.retryAfter));
		}
	}
}

/** By GET where the look has a name, so that caches keep it. @param {Wish} wish @param {AbortSignal} signal @returns {Promise<Blob>} */
async function rendered({ id, transfer, shading }, signal) {
	if (transfer === null || typeof transfer === 'string') {
		const query = { ...CAMERA, width: SIDE, height: SIDE, quality: 'draft', ...(transfer ? { preset: transfer } : {}) };
		return thumbnail(id, query, signal);
	}
	const image = { width: SIDE, height: SIDE, format: 'png' };
	const request = { camera: CAMERA, image, transfer_function: transfer, ...(shading === null ? {} : { shading }), quality: 'draft' };
	return (await frame(id, request, signal)).blob;
}

/** @param {string} id @param {State['transfer']} transfer */
const key = (id, transfer) => `${id}\n${JSON.stringify(transfer)}`;

/** An empty image that a {@link Thumbnails} may fill. */
export function emptyImage() {
	const image = new Image(SIDE / 2, SIDE / 2);
	image.alt = '';
	return image;
}
