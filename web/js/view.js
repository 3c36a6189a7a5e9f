/** @file The picture: a canvas with the newest frame's pixels, whose style puts them where the camera now says they belong (warp.js). */
import { matrix3d, placed } from './warp.js';

/** @import {Frame} from './frames.js' */

/** Pixels of a full frame at most: beyond, a screen's finest pixels cost more than they show. */
const MOST_PIXELS = 2_000_000;

export class View {
	/** @type {Frame | null} */ #frame = null;
	/** What a person looks at has another size. */
	onResize = () => {};

	/**
	 * @param {HTMLElement} element what the picture fills @param {HTMLCanvasElement} canvas in it
	 * @param {import('./state.js').Store} store
	 * @param {() => import('./camera.js').Sphere | null} sphere of the scan that the state names
	 */
	constructor(element, canvas, store, sphere) {
		this.element = element;
		this.canvas = canvas;
		this.store = store;
		this.sphere = sphere;
		new ResizeObserver(() => {
			this.#place();
			this.onResize();
		}).observe(element);
		store.subscribe(() => this.#place());
	}

	/** Pixels of the screen that the picture covers, within reason. @returns {{width: number, height: number}} */
	size() {
		const { clientWidth, clientHeight } = this.element;
		const dense = Math.min(window.devicePixelRatio, Math.sqrt(MOST_PIXELS / Math.max(1, clientWidth * clientHeight)));
		return { width: Math.max(1, Math.round(clientWidth * dense)), height: Math.max(1, Math.round(clientHeight * dense)) };
	}

	/** @param {Frame} frame */
	show(frame) {
		this.#frame?.bitmap.close();
		this.#frame = frame;
		[this.canvas.width, this.canvas.height] = [frame.bitmap.width, frame.bitmap.height];
		this.canvas.getContext('2d')?.drawImage(frame.bitmap, 0, 0);
		this.canvas.classList.toggle('unwarped', Boolean(frame.warp));
		this.#place();
	}

	#place() {
		const { element, canvas, store: { state } } = this;
		const frame = this.#frame;
		const sphere = this.sphere();
		element.style.backgroundColor = state.background;
		element.classList.toggle('checkered', state.background === 'transparent');
		canvas.hidden = !frame || !sphere || frame.state.volume !== state.volume;
		if (!frame || !sphere) return;
		const view = { width: element.clientWidth, height: element.clientHeight };
		canvas.style.transform = matrix3d(placed(frame, state.camera, sphere, view));
	}
}
