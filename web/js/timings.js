/** @file Where a frame's time went, the service's stages and the way: closed two numbers, open a graph of the last frames. */
import { el, icon } from './dom.js';

/** @import {Frame} from './frames.js' */

/** From the bottom of a bar to its top; `way` is what the service's own total leaves of the latency. */
const COLORS = { queue: '#f2a65a', prepare: '#e0709b', shade: '#f6d860', composite: '#3fb8a6', warp: '#6fa8ff', encode: '#b18cf0', way: '#6b7684' };
const STAGES = Object.keys(COLORS);
const BARS = 60;
/** Milliseconds that the frame rate looks back. */
const LOOK_BACK = 1000;

export class Timings {
	/** @type {Record<string, number>[]} */ #bars = [];
	/** @type {number[]} */ #times = [];

	constructor() {
		this.numbers = el('span', { class: 'numbers' }, '–');
		this.canvas = el('canvas', { width: 480, height: 120, role: 'img', 'aria-label': 'Time per frame, by stage' });
		this.legend = el('ul', { class: 'legend' }, ...STAGES.map((stage) => el('li', {}, el('span', {}, stage), el('b'))));
		[...this.legend.querySelectorAll('li')].forEach((item, i) => item.style.setProperty('--stage', Object.values(COLORS)[i]));
		this.details = el('p', { class: 'details' });
		const summary = el('summary', { title: 'Frame rate and latency' }, icon('pulse'), this.numbers);
		this.element = el('details', { class: 'timings', ontoggle: () => this.#draw() }, summary,
			el('div', { class: 'timings-body' }, this.canvas, this.legend, this.details));
	}

	/** @param {Frame} frame */
	add(frame) {
		const { stages, latency } = frame;
		const total = stages.total ?? 0;
		const way = Math.max(0, latency - total);
		this.#bars.push({ ...stages, way });
		if (this.#bars.length > BARS) this.#bars.shift();
		const now = performance.now();
		this.#times = [...this.#times.filter((time) => now - time < LOOK_BACK), now];
		const rate = this.#times.length > 4 ? `${Math.round(((this.#times.length - 1) * 1000) / (now - this.#times[0]))} fps · ` : '';
		this.numbers.textContent = `${rate}${latency.toFixed(0)} ms`;
		this.details.textContent = `${frame.stage} · ${frame.algorithm} · ${frame.bitmap.width} × ${frame.bitmap.height} · ${(frame.blob.size / 1000).toFixed(0)} kB · service ${total.toFixed(1)} ms`;
		this.#draw();
	}

	#draw() {
		const last = this.#bars.at(-1);
		if (!this.element.open || !last) return;
		const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext('2d'));
		const { width, height } = this.canvas;
		const sums = this.#bars.map((bar) => STAGES.reduce((sum, stage) => sum + (bar[stage] ?? 0), 0));
		const most = Math.max(10, ...sums);
		context.clearRect(0, 0, width, height);
		this.#bars.forEach((bar, i) => {
			let y = height;
			STAGES.forEach((stage, s) => {
				const tall = ((bar[stage] ?? 0) / most) * (height - 14);
				context.fillStyle = Object.values(COLORS)[s];
				context.fillRect((i * width) / BARS, y - tall, width / BARS - 1, tall);
				y -= tall;
			});
		});
		context.fillStyle = getComputedStyle(this.legend).color;
		context.font = '20px system-ui, sans-serif';
		context.textBaseline = 'top';
		context.fillText(`${most.toFixed(0)} ms`, 2, 0);
		STAGES.forEach((stage, s) => {
			const value = this.legend.children[s].lastElementChild;
			if (value) value.textContent = (last[stage] ?? 0).toFixed(1);
		});
	}
}
