/**
 * @file The drawing of a transfer function over a histogram: axes, curve, colours, points.
 * The opacity axis is a cube root, see {@link heightOf}; counts are on a logarithmic one: tissue is a thousandth
 * of the air around it.
 */
import { svg } from './dom.js';
import { heightOf, opacityOf, sampled, ticks } from './transfer.js';

/** @import {ControlPoint} from './state.js' */
/** @import {Histogram} from './api.js' */
/** @typedef {[number, number]} Range */

/** Pixels around and below the plot. */
const EDGE = { left: 30, right: 10, top: 12, bottom: 34 };
const STRIP = 8;
const HEIGHT = 190;
const BASE = HEIGHT - EDGE.bottom;
/** Pixels around a point in which a pointer takes hold of it. */
const HOLD = 14;
const LABELLED = [0.001, 0.01, 0.1, 0.5, 1];
/** Straight pieces for a stretch between two points, which the axis bends. */
const PIECES = 12;

export class TransferPlot {
	/** Values from the left to the right border. @type {Range} */ domain = [0, 1];
	width = 320;

	constructor() {
		const gradient = svg('linearGradient', { id: 'transfer-colors', gradientUnits: 'userSpaceOnUse' });
		this.parts = {
			gradient,
			grid: svg('g', { class: 'grid' }),
			histogram: svg('path', { class: 'histogram' }),
			area: svg('path', { class: 'area', fill: 'url(#transfer-colors)' }),
			curve: svg('path', { class: 'curve' }),
			strip: svg('rect', { fill: 'url(#transfer-colors)', height: STRIP, rx: 2 }),
			points: svg('g', { class: 'points' }),
		};
		const { grid, histogram, area, curve, strip, points } = this.parts;
		const label = 'Opacity and colour over the scan’s values';
		this.element = svg('svg', { class: 'transfer-plot', height: HEIGHT, role: 'group', 'aria-label': label },
			svg('defs', {}, gradient), histogram, grid, area, curve, strip, points);
	}

	/** @param {number} value */
	x(value) {
		const [low, high] = this.domain;
		return EDGE.left + ((value - low) / (high - low)) * this.#inner;
	}

	/** @param {number} x */
	value(x) {
		const [low, high] = this.domain;
		return low + ((x - EDGE.left) / this.#inner) * (high - low);
	}

	/** @param {number} opacity */
	y(opacity) {
		return BASE - heightOf(opacity) * (BASE - EDGE.top);
	}

	/** @param {number} y */
	opacity(y) {
		const opacity = opacityOf((BASE - y) / (BASE - EDGE.top));
		return opacity < 5e-5 ? 0 : Number(opacity.toPrecision(3));
	}

	/** Whether a height is that of the plot and not of the axis below. @param {number} y */
	covers(y) {
		return y <= BASE + STRIP;
	}

	/** The point that a pointer takes hold of, or -1; of several in one place the last. @param {ControlPoint[]} points @param {number} x @param {number} y */
	nearest(points, x, y) {
		let [index, least] = [-1, HOLD];
		points.forEach((point, i) => {
			const at = this.x(point.value);
			const apart = this.#inside(at) ? Math.hypot(at - x, this.y(point.opacity) - y) : Infinity;
			if (apart <= least) [index, least] = [i, apart];
		});
		return index;
	}

	/** Width of the domain. */
	get span() {
		return this.domain[1] - this.domain[0];
	}

	get perPixel() {
		return this.span / this.#inner;
	}

	get #inner() {
		return this.width - EDGE.left - EDGE.right;
	}

	/** @param {number} x */
	#inside(x) {
		return x >= EDGE.left - 1 && x <= this.width - EDGE.right + 1;
	}

	/** @param {ControlPoint[]} points none while they are not known @param {Histogram | null} histogram @param {number} selected index of a point, or -1 */
	draw(points, histogram, selected) {
		this.element.setAttribute('width', String(this.width));
		this.element.classList.toggle('waiting', points.length === 0);
		this.#drawGrid();
		this.#drawHistogram(histogram);
		const { curve, area, strip } = this.parts;
		for (const part of [curve, area, strip]) part.toggleAttribute('hidden', points.length === 0);
		if (points.length > 0) {
			this.#drawCurve(points);
			this.#drawColors(points);
		}
		this.#drawPoints(points, selected);
	}

	#drawGrid() {
		const right = this.width - EDGE.right;
		const lines = LABELLED.flatMap((opacity) => [
			svg('line', { x1: EDGE.left, x2: right, y1: this.y(opacity), y2: this.y(opacity) }),
			svg('text', { x: EDGE.left - 5, y: this.y(opacity) + 3, 'text-anchor': 'end' }, String(opacity).replace('0.', '.')),
		]);
		const values = ticks(this.domain).map((value) =>
			svg('text', { x: this.x(value), y: HEIGHT - 6, 'text-anchor': 'middle' }, value.toLocaleString('en')));
		this.parts.grid.replaceChildren(...lines, ...values);
	}

	/** @param {Histogram | null} histogram */
	#drawHistogram(histogram) {
		const { histogram: path } = this.parts;
		path.toggleAttribute('hidden', histogram === null);
		if (!histogram) return;
		const { bins, min, max, counts } = histogram;
		const most = Math.log1p(counts.reduce((a, b) => Math.max(a, b), 1));
		const at = (/** @type {number} */ bin) => this.x(min + ((bin + 0.5) / bins) * (max - min));
		const tops = counts.map((count, bin) => [at(bin), BASE - (Math.log1p(count) / most) * (BASE - EDGE.top)]);
		const shown = tops.filter(([x]) => this.#inside(x));
		if (shown.length === 0) return path.removeAttribute('d');
		path.setAttribute('d', `M${fixed([shown[0][0], BASE])}${lines(shown)}L${fixed([shown[shown.length - 1][0], BASE])}Z`);
	}

	/** @param {ControlPoint[]} points */
	#drawCurve(points) {
		const [left, right] = [EDGE.left, this.width - EDGE.right];
		const border = (/** @type {number} */ i) => this.y(sampled(points, this.domain[i]).opacity);
		const bent = points.flatMap((point, i) => (i > 0 ? this.#stretch(points[i - 1], point) : [[this.x(point.value), this.y(point.opacity)]]));
		const line = [[left, border(0)], ...bent.filter(([x]) => x >= left && x <= right), [right, border(1)]];
		this.parts.curve.setAttribute('d', `M${lines(line).slice(1)}`);
		this.parts.area.setAttribute('d', `M${left},${BASE}${lines(line)}L${right},${BASE}Z`);
	}

	/** Straight between two points on a linear axis, and so a curve on this one; a step stays a step. @param {ControlPoint} a @param {ControlPoint} b */
	#stretch(a, b) {
		return Array.from({ length: PIECES }, (_, i) => {
			const part = (i + 1) / PIECES;
			return [this.x(a.value + (b.value - a.value) * part), this.y(a.opacity + (b.opacity - a.opacity) * part)];
		});
	}

	/** @param {ControlPoint[]} points */
	#drawColors(points) {
		const [left, right] = [EDGE.left, this.width - EDGE.right];
		const { gradient, strip } = this.parts;
		const places = { x: left, y: BASE + 4, width: right - left };
		for (const [name, value] of Object.entries(places)) strip.setAttribute(name, String(value));
		gradient.setAttribute('x1', String(left));
		gradient.setAttribute('x2', String(right));
		const [first, last] = this.domain;
		const within = points.filter(({ value }) => value > first && value < last);
		const stops = [sampled(points, first), ...within, sampled(points, last)];
		gradient.replaceChildren(...stops.map(({ value, color }) => svg('stop', { offset: (value - first) / (last - first), 'stop-color': color })));
	}

	/** Elements are kept while their number is the same, so that a drag and the focus survive. @param {ControlPoint[]} points @param {number} selected */
	#drawPoints(points, selected) {
		const group = this.parts.points;
		while (group.children.length > points.length) group.lastElementChild?.remove();
		while (group.children.length < points.length)
			group.append(svg('g', { class: 'point', role: 'slider', tabindex: 0 }, svg('circle', { class: 'halo', r: HOLD }), svg('circle', { class: 'dot', r: 6 })));
		points.forEach(({ value, opacity, color }, index) => {
			const element = group.children[index];
			const x = this.x(value);
			element.setAttribute('transform', `translate(${fixed([x, this.y(opacity)])})`);
			element.toggleAttribute('hidden', !this.#inside(x));
			element.classList.toggle('selected', index === selected);
			element.setAttribute('aria-label', `Point ${index + 1} of ${points.length}`);
			element.setAttribute('aria-valuenow', String(value));
			element.setAttribute('aria-valuemin', String(points[index - 1]?.value ?? this.domain[0]));
			element.setAttribute('aria-valuemax', String(points[index + 1]?.value ?? this.domain[1]));
			element.setAttribute('aria-valuetext', `value ${value}, opacity ${opacity}, colour ${color}`);
			element.lastElementChild?.setAttribute('fill', color);
		});
	}
}

/** @param {number[]} point */
const fixed = ([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`;

/** @param {number[][]} points */
const lines = (points) => points.map((point) => `L${fixed(point)}`).join('');
