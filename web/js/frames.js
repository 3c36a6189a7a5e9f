/**
 * @file Which frame to ask for next.
 * The newest view wins: at most two drafts are under way (the second fills the line while the first is drawn). Once the view rests,
 * the same is asked for in `standard`, then in `high` where that is fast; both are given up at the next move.
 */
import { Problem } from './api.js';

/** @import {State} from './state.js' */
/** @import {FrameAnswer} from './api.js' */
/** @import {Size} from './request.js' */
/** @typedef {'draft' | 'standard' | 'high'} Stage */
/** @typedef {(state: State, size: Size, stage: Stage, signal: AbortSignal) => Promise<FrameAnswer | null>} Source `null`: passed over for a newer one */
/** @typedef {FrameAnswer & {bitmap: ImageBitmap, state: State, size: Size, stage: Stage, latency: number}} Frame */
/** @typedef {ReturnType<typeof setTimeout> | 0} Timer 0 where none runs */
/** @typedef {{version: number, stage: Stage, abort: AbortController, started: number}} Flight */

/** @type {Stage[]} */
const STAGES = ['draft', 'standard', 'high'];

/** Milliseconds without a move after which a view rests. */
const REST = 100;
/** Drafts under way at once; one where the service takes as many ms for each as `DEAR`. */
const DRAFTS = 2;
const DEAR = 250;
/** Milliseconds that a refinement nobody asked for may take. */
const PATIENCE = 3000;
/** Parts of the full resolution that drafts may have, and the cost in ms that they aim between. */
const SCALES = [1, 0.75, 0.5, 0.35];
const COST = { least: 16, most: 45 };

export class Frames {
	/** @type {Flight[]} */ #flights = [];
	#version = 0;
	#shown = { version: -1, rank: -1 };
	/** Whether more of this version was refused, failed, or is too slow. */
	#hopeless = false;
	#moving = false;
	#paused = false;
	#failures = 0;
	#scale = 1;
	/** Of drafts, ms: what the service and the picture's way take, smoothed and of the last; and all of it. */
	#cost = NaN;
	#last = 0;
	#latency = 0;
	/** @type {Timer} */ #rest = 0;
	/** @type {Timer} */ #retry = 0;
	/** @type {Timer} */ #second = 0;
	/** Kinds of views whose `high` took too long. @type {Set<string>} */
	#slow = new Set();
	/** @type {((frame: Frame) => void)[]} */ onFrame = [];
	onProblem = (/** @type {Problem | null} */ _problem) => {};
	/** Whether something is under way that refines the picture at rest. */
	onRefining = (/** @type {boolean} */ _busy) => {};

	/** @param {() => State} state @param {() => Size} size the full resolution @param {Source} source */
	constructor(state, size, source) {
		this.state = state;
		this.size = size;
		this.source = source;
	}

	/** The view is another. @param {boolean} moving whether the next will follow at once */
	changed(moving) {
		this.#version++;
		this.#hopeless = false;
		this.#moving = moving;
		clearTimeout(this.#rest);
		if (moving) this.#rest = setTimeout(() => this.#settle(), REST);
		this.#abort(({ stage }) => stage !== 'draft');
		this.#pump();
	}

	/** Another scan: what is under way is of no use. */
	dropAll() {
		this.#abort(() => true);
		this.#shown = { version: -1, rank: -1 };
		this.#cost = NaN;
	}

	/** Whether all is shown that will be. */
	get idle() {
		return !this.#paused && this.#flights.length === 0 && !this.#moving && !this.#retry && this.#next() === null;
	}

	/** Asks again at once after a problem that may have passed. */
	retry() {
		clearTimeout(this.#retry);
		this.#retry = 0;
		this.#pump();
	}

	/** A page that nobody sees asks for nothing. @param {boolean} paused */
	pause(paused) {
		this.#paused = paused;
		if (paused) this.#abort(() => true);
		else this.#pump();
	}

	#settle() {
		this.#moving = false;
		this.#pump();
	}

	/** @param {(flight: Flight) => boolean} which */
	#abort(which) {
		for (const flight of this.#flights.filter(which)) flight.abort.abort();
		this.#flights = this.#flights.filter((flight) => !which(flight));
		this.onRefining(this.#flights.some(({ stage }) => stage === 'high'));
	}

	/** What the newest view lacks. @returns {Stage | null} */
	#next() {
		if (this.#hopeless) return null;
		const state = this.state();
		const has = Math.max(
			this.#shown.version === this.#version ? this.#shown.rank : -1,
			...this.#flights.map(({ version, stage }) => (version === this.#version ? STAGES.indexOf(stage) : -1)),
		);
		if (this.#moving) return has < 0 ? 'draft' : null;
		const wanted = state.quality === 'auto' ? (this.#slow.has(this.#kind()) ? 1 : 2) : STAGES.indexOf(state.quality);
		const last = rendersHigh(state) ? wanted : Math.min(wanted, 1);
		return has < last ? STAGES[Math.max(has + 1, Math.min(last, 1))] : null;
	}

	/** What makes one view as dear as another. */
	#kind() {
		const { volume, algorithm, blend, camera } = this.state();
		return [volume, algorithm, blend, camera.projection].join(' ');
	}

	#pump() {
		if (this.#paused || this.#retry || !this.state().volume) return;
		const stage = this.#next();
		if (!stage) return;
		// Refinements wait for what they refine.
		const newest = this.#flights.some(({ version }) => version === this.#version);
		const drafts = this.#flights.filter((flight) => flight.stage === 'draft');
		if (stage === 'draft' ? drafts.length >= (this.#last > DEAR ? 1 : DRAFTS) || this.#tooSoon(drafts) : newest) return;
		this.#fly(stage);
	}

	/** A second draft helps when it starts half way through the first one, not right behind it. @param {Flight[]} drafts */
	#tooSoon(drafts) {
		const last = drafts.at(-1);
		const wait = last ? last.started + this.#latency / DRAFTS - performance.now() : 0;
		clearTimeout(this.#second);
		if (wait > 1) this.#second = setTimeout(() => this.#pump(), wait);
		return wait > 1;
	}

	/** @param {Stage} stage */
	async #fly(stage) {
		const abort = new AbortController();
		const state = this.state();
		const size = stage === 'draft' ? this.#draftSize() : this.size();
		/** @type {Flight} */
		const flight = { version: this.#version, stage, abort, started: performance.now() };
		this.#flights.push(flight);
		this.onRefining(stage === 'high');
		const kind = this.#kind();
		const unasked = stage === 'high' && state.quality === 'auto';
		const patience = unasked ? setTimeout(() => this.#tooSlow(flight, kind), PATIENCE) : 0;
		let answer;
		try {
			answer = await this.source(state, size, stage, abort.signal);
			const bitmap = answer && (await createImageBitmap(answer.blob));
			if (answer && bitmap && !abort.signal.aborted) this.#landed(flight, { ...answer, bitmap, state, size, stage, latency: performance.now() - flight.started });
		} catch (error) {
			if (!abort.signal.aborted) this.#failed(flight, error);
		} finally {
			clearTimeout(patience);
			answer?.drawn?.();
			this.#flights = this.#flights.filter((other) => other !== flight);
			this.onRefining(this.#flights.some((other) => other.stage === 'high'));
			this.#pump();
		}
	}

	/** @param {Flight} flight @param {string} kind */
	#tooSlow(flight, kind) {
		this.#slow.add(kind);
		if (flight.version === this.#version) this.#hopeless = true;
		flight.abort.abort();
	}

	/** @param {Flight} flight @param {Frame} frame */
	#landed(flight, frame) {
		this.#failures = 0;
		this.onProblem(null);
		if (flight.stage === 'draft') this.#adapt(frame);
		const rank = STAGES.indexOf(flight.stage);
		const newer = flight.version > this.#shown.version;
		if (!newer && !(flight.version === this.#shown.version && rank > this.#shown.rank)) return frame.bitmap.close();
		this.#shown = { version: flight.version, rank };
		for (const listener of this.onFrame) listener(frame);
	}

	/** @param {Flight} flight @param {unknown} error */
	#failed(flight, error) {
		const problem = error instanceof Problem ? error : new Problem('failed', String(error));
		if (problem.passing) {
			this.#failures++;
			const seconds = problem.kind === 'gone' ? Math.min(8, 2 ** (this.#failures - 1)) : problem.retryAfter;
			// Many viewers were refused at once; they should not come back at once.
			this.#retry ||= setTimeout(() => this.retry(), seconds * 1000 * (1 + Math.random() / 4));
			problem.retryAfter = seconds;
		} else if (flight.version === this.#version) {
			this.#hopeless = true;
		}
		this.onProblem(problem);
	}

	#draftSize() {
		const { width, height } = this.size();
		const scaled = (/** @type {number} */ side) => Math.max(1, Math.round(side * this.#scale));
		return { width: scaled(width), height: scaled(height) };
	}

	/** Drafts get smaller where they are dear and larger where they are cheap. The line's delay is not counted: smaller pictures do not shorten it. @param {Frame} frame */
	#adapt({ stages, downloaded, latency }) {
		this.#latency = this.#latency ? 0.7 * this.#latency + 0.3 * latency : latency;
		const cost = (stages.total ?? 0) - (stages.prepare ?? 0) + downloaded;
		this.#last = cost;
		this.#cost = Number.isNaN(this.#cost) ? cost : 0.7 * this.#cost + 0.3 * cost;
		const at = SCALES.indexOf(this.#scale);
		if (this.#cost > COST.most && at < SCALES.length - 1) this.#rescale(SCALES[at + 1]);
		else if (this.#cost < COST.least && at > 0) this.#rescale(SCALES[at - 1]);
	}

	/** @param {number} scale */
	#rescale(scale) {
		// What the next drafts will cost is not known: halfway between the bounds is neither too much nor too little.
		this.#scale = scale;
		this.#cost = (COST.least + COST.most) / 2;
	}
}

/** Voxel-lattice algorithms have no `high`. @param {State} state */
export const rendersHigh = ({ algorithm }) => algorithm !== 'classified' && algorithm !== 'fast-classification';
