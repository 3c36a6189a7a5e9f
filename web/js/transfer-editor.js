/**
 * @file Editing a transfer function over the histogram.
 * Points are elements of their own, so that each can be focused, named and moved by keys like a slider.
 */
import { el } from './dom.js';
import { heightOf, opacityOf, sampled, short, withChanged, withPoint, withoutPoint } from './transfer.js';
import { TransferPlot } from './transfer-plot.js';

/** @import {ControlPoint} from './state.js' */
/** @import {Histogram} from './api.js' */
/** @import {Look} from './look.js' */
/** @typedef {[number, number]} Range */

/** Pixels that a click may move before it is a drag. */
const SLACK = 4;

export class TransferEditor {
	/** The point in hand. */ selected = -1;
	/** @type {(() => void)} */ onSelect = () => {};
	/** @type {Histogram | null} */ #histogram = null;
	/** @type {{index: number, x: number, y: number, moved: boolean} | null} */ #drag = null;
	plot = new TransferPlot();

	/** @param {Look} look */
	constructor(look) {
		this.look = look;
		this.readout = el('p', { class: 'readout', 'aria-hidden': 'true' });
		this.element = el('div', { class: 'transfer-editor' }, this.plot.element, this.readout);
		this.#listen();
		new ResizeObserver(([{ contentRect }]) => {
			if (contentRect.width > 0) this.plot.width = contentRect.width;
			this.draw();
		}).observe(this.element);
		look.onChange.push((another) => (another ? this.showAll() : this.draw()));
	}

	#listen() {
		const { element: plot } = this.plot;
		plot.addEventListener('pointerdown', (event) => this.#down(event));
		// The focus goes to the nearest point too, not to the one that lies on top.
		plot.addEventListener('mousedown', (event) => this.#at(event).index >= 0 && event.preventDefault());
		plot.addEventListener('pointermove', (event) => this.#move(event));
		plot.addEventListener('pointerup', (event) => this.#up(event));
		plot.addEventListener('pointercancel', () => (this.#drag = null));
		plot.addEventListener('pointerleave', () => (this.readout.textContent = ''));
		plot.addEventListener('contextmenu', (event) => this.#menu(event));
		plot.addEventListener('keydown', (event) => this.#key(event));
		plot.addEventListener('keyup', () => this.look.commit());
		plot.addEventListener('wheel', (event) => this.#wheel(event), { passive: false });
	}

	/** @param {Histogram | null} histogram of the scan in sight */
	setHistogram(histogram) {
		this.#histogram = histogram;
		this.selected = -1;
		this.showAll();
	}

	/** The scan's values, and points beyond them as long as these do not squeeze the histogram. */
	showAll() {
		if (this.#histogram) {
			const { min, max } = this.#histogram;
			const points = this.look.current?.points ?? [];
			const [least, most] = spread([min, max], 0.5);
			const [first, last] = [points[0]?.value ?? min, points[points.length - 1]?.value ?? max];
			this.plot.domain = spread([Math.min(min, Math.max(least, first)), Math.max(max, Math.min(most, last))], 0.02);
		}
		this.draw();
	}

	/** The values that the points lie on. */
	showPoints() {
		const points = this.look.current?.points;
		if (points) this.plot.domain = spread([points[0].value, points[points.length - 1].value], 0.1);
		this.draw();
	}

	draw() {
		const points = this.look.current?.points ?? [];
		this.selected = Math.min(this.selected, points.length - 1);
		this.plot.draw(points, this.#histogram, this.selected);
		this.onSelect();
	}

	/** @param {MouseEvent} event @returns {{x: number, y: number, index: number}} */
	#at(event) {
		const { left, top } = this.plot.element.getBoundingClientRect();
		const [x, y] = [event.clientX - left, event.clientY - top];
		return { x, y, index: this.plot.nearest(this.look.current?.points ?? [], x, y) };
	}

	/** @param {PointerEvent} event */
	#down(event) {
		if (event.button !== 0 || !this.look.current) return;
		const at = this.#at(event);
		this.plot.element.setPointerCapture(event.pointerId);
		this.#drag = { ...at, moved: false };
		if (at.index >= 0) this.select(at.index, true);
	}

	/** @param {PointerEvent} event */
	#move(event) {
		const { x, y } = this.#at(event);
		this.#read(x, y);
		const drag = this.#drag;
		const transfer = this.look.current;
		if (!drag || !transfer) return;
		const [dx, dy] = [x - drag.x, y - drag.y];
		if (!drag.moved && Math.hypot(dx, dy) < SLACK) return;
		drag.moved = true;
		if (drag.index >= 0) {
			const patch = { value: short(this.plot.value(x), this.plot.span), opacity: this.plot.opacity(y) };
			this.look.edit(withChanged(transfer, drag.index, patch), true);
			return;
		}
		const window = this.look.window;
		if (window) this.look.setWindow({ center: window.center + dx * this.plot.perPixel, width: window.width * Math.exp(-dy / 100) }, true);
		[drag.x, drag.y] = [x, y];
	}

	/** @param {PointerEvent} event */
	#up(event) {
		const drag = this.#drag;
		this.#drag = null;
		if (!drag) return;
		if (drag.moved) this.look.commit();
		else if (drag.index < 0) this.#add(this.#at(event));
	}

	/** @param {{x: number, y: number}} at */
	#add({ x, y }) {
		const transfer = this.look.current;
		if (!transfer || !this.plot.covers(y)) return;
		const value = short(this.plot.value(x), this.plot.span);
		this.#insert({ ...sampled(transfer.points, value), opacity: this.plot.opacity(y) });
	}

	/** A point in the middle of the selected stretch, on the curve: it changes nothing until it is moved. */
	addHere() {
		const points = this.look.current?.points;
		if (!points) return;
		const [at, next] = [points[Math.max(0, this.selected)], points[Math.max(0, this.selected) + 1]];
		const value = next ? (at.value + next.value) / 2 : at.value + this.plot.span / 20;
		this.#insert(sampled(points, short(value, this.plot.span)));
	}

	/** @param {ControlPoint} point */
	#insert(point) {
		if (!this.look.current) return;
		const [transfer, index] = withPoint(this.look.current, point);
		this.selected = index;
		this.look.edit(transfer);
		this.select(index, true);
	}

	/** @param {number} index @param {boolean} [focus] */
	select(index, focus = false) {
		this.selected = index;
		this.draw();
		if (focus) /** @type {SVGElement | undefined} */ (this.plot.parts.points.children[index])?.focus();
	}

	/** Removes the point in hand; the last one stays. */
	remove() {
		const transfer = this.look.current;
		if (!transfer || this.selected < 0 || transfer.points.length < 2) return;
		const index = this.selected;
		this.selected = Math.max(0, index - 1);
		this.look.edit(withoutPoint(transfer, index));
		this.select(this.selected, true);
	}

	/** @param {MouseEvent} event */
	#menu(event) {
		event.preventDefault();
		const { index } = this.#at(event);
		if (index < 0) return;
		this.selected = index;
		this.remove();
	}

	/** @param {KeyboardEvent} event */
	#key(event) {
		const point = event.target instanceof Element ? event.target.closest('.point') : null;
		const index = point ? [...this.plot.parts.points.children].indexOf(point) : -1;
		const transfer = this.look.current;
		if (index < 0 || !transfer) return;
		this.selected = index;
		const { value, opacity } = transfer.points[index];
		const coarse = event.shiftKey ? 5 : 1;
		const sideways = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
		const upward = { ArrowUp: 1, ArrowDown: -1 }[event.key];
		if (sideways) this.look.edit(withChanged(transfer, index, { value: short(value + (sideways * coarse * this.plot.span) / 200, this.plot.span) }), true);
		else if (upward) {
			const height = heightOf(opacity) + upward * coarse * 0.01;
			this.look.edit(withChanged(transfer, index, { opacity: Number(opacityOf(height).toPrecision(3)) }), true);
		} else if (event.key === 'Delete' || event.key === 'Backspace') this.remove();
		else return;
		event.preventDefault();
	}

	/** Enlarges the axis about the pointer; without Ctrl, which a pinch has too, the wheel is for the panel. @param {WheelEvent} event */
	#wheel(event) {
		if (!event.ctrlKey) return;
		event.preventDefault();
		const at = this.plot.value(this.#at(event).x);
		// A pinch comes in steps of a few, a wheel in steps of a hundred.
		const factor = Math.exp(Math.max(-40, Math.min(40, event.deltaY)) * 0.01);
		const whole = this.#histogram ? spread([this.#histogram.min, this.#histogram.max], 0.5) : this.plot.domain;
		const low = Math.max(whole[0], at + (this.plot.domain[0] - at) * factor);
		const high = Math.min(whole[1], at + (this.plot.domain[1] - at) * factor);
		if (high - low > (whole[1] - whole[0]) / 1000) this.plot.domain = [low, high];
		this.draw();
	}

	/** @param {number} x @param {number} y */
	#read(x, y) {
		const value = short(this.plot.value(x), this.plot.span);
		this.readout.textContent = `${value.toLocaleString('en')} · opacity ${this.plot.opacity(y)}`;
	}
}

/** @param {Range} range @param {number} part @returns {Range} */
function spread([low, high], part) {
	const more = (high - low || 1) * part;
	return [low - more, high + more];
}
