/**
 * @file Frames over one connection, and over HTTP where there is none: the page's only source.
 * The protocol is that of docs/stream.md, kept to its simplest use: every request goes whole and names one quality, `moving` too,
 * so that one frame answers it. HTTP is the way until a connection is open and once it has ended.
 */
import { problemIn } from './api.js';
import { renderRequest } from './request.js';

/** @import {Source} from './frames.js' */
/** @import {FrameAnswer} from './api.js' */
/**
 * @typedef {object} Waiter for the frame of a request
 * @property {number} first number of its message, as the service counts
 * @property {number} last number of the same message sent again
 * @property {object} message
 * @property {number} sent
 * @property {(answer: FrameAnswer | null | Promise<FrameAnswer | null>) => void} resolve `null`: a newer one took its place
 * @property {(error: unknown) => void} reject
 * @property {() => void} again asks over HTTP
 * @property {ReturnType<typeof setTimeout> | 0} timer
 */

/** Milliseconds after which the service drops a frame for a newer request, and a little. */
const SLOW = 120;
/** Milliseconds without an answer after which a connection is taken for dead; `high` may take its time. */
const PATIENCE = 10_000;
/** Milliseconds between attempts to connect. */
const PAUSE = { least: 1000, most: 60_000 };

export class Stream {
	/** @type {WebSocket | null} */ #socket = null;
	#volume = '';
	/** Oldest first. @type {Waiter[]} */ #waiting = [];
	/** Requests sent (less those refused: the service does not count them), and the newest that was answered. */
	#sent = 0;
	#answered = 0;
	/** Of the line, ms: what it takes at least; when the last frame came. */
	#delay = 0;
	#last = 0;
	/** When the next attempt to connect may be, and the pause after it. */
	#next = 0;
	#pause = PAUSE.least;

	/** @param {Source} http */
	constructor(http) {
		this.http = http;
	}

	/** @type {Source} */
	source = async (state, size, stage, signal) => {
		if (state.volume !== this.#volume) {
			this.close();
			this.#volume = state.volume;
		}
		if (this.#socket?.readyState === WebSocket.OPEN) return this.#ask(state, size, stage, signal);
		const answer = await this.http(state, size, stage, signal);
		if (state.volume === this.#volume && !signal.aborted) this.#open();
		return answer;
	};

	/** Gives the connection's place to others, until the next frame is asked for. */
	close() {
		const socket = this.#socket;
		this.#socket = null;
		if (socket) {
			socket.onmessage = socket.onclose = null;
			// A handshake that is given up half way is an error in the browser's eyes.
			socket.onopen = () => socket.close();
			if (socket.readyState !== WebSocket.CONNECTING) socket.close();
		}
		for (const { again } of this.#remove(() => true)) again();
	}

	#open() {
		const began = performance.now();
		if (this.#socket || began < this.#next) return;
		const address = new URL(`v1/volumes/${encodeURIComponent(this.#volume)}/stream`, document.baseURI);
		const socket = new WebSocket(address.href.replace(/^http/, 'ws'));
		this.#socket = socket;
		this.#sent = this.#answered = 0;
		socket.binaryType = 'arraybuffer';
		socket.onopen = () => (this.#delay = performance.now() - began);
		socket.onclose = () => this.#lost();
		socket.onmessage = ({ data }) => (typeof data === 'string' ? this.#refused(JSON.parse(data)) : this.#arrived(data));
	}

	/** The connection could not be opened, or has ended. */
	#lost() {
		// Many viewers lost theirs at once; they should not come back at once.
		this.#next = performance.now() + this.#pause * (1 + Math.random() / 4);
		this.#pause = Math.min(2 * this.#pause, PAUSE.most);
		this.close();
	}

	/** @param {object} message a request @returns {number} its number */
	#send(message) {
		this.#socket?.send(JSON.stringify(message));
		return ++this.#sent;
	}

	/** @param {Parameters<Source>} asked @returns {Promise<FrameAnswer | null>} */
	#ask(...asked) {
		const [state, size, stage, signal] = asked;
		return new Promise((resolve, reject) => {
			const message = { request: renderRequest(state, size, stage, true), moving: stage };
			const number = this.#send(message);
			const timer = stage === 'high' ? 0 : setTimeout(() => this.#lost(), PATIENCE);
			/** @type {Waiter} */
			const waiter = { first: number, last: number, message, sent: performance.now(), resolve, reject, again: () => resolve(this.http(...asked)), timer };
			this.#waiting.push(waiter);
			signal.addEventListener('abort', () => {
				if (this.#remove((other) => other === waiter).length === 0) return;
				resolve(null);
				if (stage !== 'draft') setTimeout(() => this.#end(waiter), Math.max(0, waiter.sent + SLOW - performance.now()));
			});
		});
	}

	/**
	 * Ends the service's work on a refinement that was given up. The next request does so, unless there is none, or it came
	 * while the service was still unwilling: then it is said again. @param {Waiter} given
	 */
	#end({ last, sent }) {
		if (!this.#socket || this.#answered >= last || this.#sent < last) return;
		const newest = this.#waiting.at(-1);
		if (!newest) {
			if (this.#sent === last) this.#send({ patch: { quality: 'draft' }, moving: 'draft' });
		} else if (newest.sent < sent + SLOW) {
			newest.last = this.#send(newest.message);
			newest.sent = performance.now();
		}
	}

	/** @param {(waiter: Waiter) => boolean} which @returns {Waiter[]} */
	#remove(which) {
		const removed = this.#waiting.filter(which);
		for (const { timer } of removed) clearTimeout(timer);
		this.#waiting = this.#waiting.filter((waiter) => !which(waiter));
		return removed;
	}

	/** @param {ArrayBuffer} data */
	#arrived(data) {
		const length = new DataView(data).getUint32(0, true);
		const { sequence, request, format, algorithm, timing, warp } = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
		const now = performance.now();
		const gap = now - this.#last;
		const socket = this.#socket;
		const drawn = () => socket === this.#socket && socket?.send(JSON.stringify({ ack: sequence }));
		this.#pause = PAUSE.least;
		this.#answered = request;
		this.#last = now;
		for (const { resolve } of this.#remove(({ last }) => last < request)) resolve(null);
		const [waiter] = this.#remove(({ first }) => first <= request);
		if (!waiter) return drawn();
		// The line's share is what frames take beyond its delay, or the time between two: with two on their way one waits for the other.
		const way = now - waiter.sent - timing.total;
		this.#delay = Math.min(this.#delay, way);
		const downloaded = Math.max(0, Math.min(way - this.#delay, gap) - timing.total);
		const blob = new Blob([new Uint8Array(data, 4 + length)], { type: `image/${format}` });
		waiter.resolve({ blob, stages: timing, algorithm, warp, downloaded, drawn });
	}

	/** @param {{request: number, error: any}} refusal */
	#refused({ request, error }) {
		const problem = problemIn(error);
		if (error.status < 500) {
			// Refused as it came, and not counted: it was the one after the last that was taken.
			const number = request + 1;
			for (const { reject } of this.#remove(({ first, last }) => first <= number && number <= last)) reject(problem);
			for (const waiter of this.#waiting.filter(({ first }) => first > number)) [waiter.first, waiter.last] = [waiter.first - 1, waiter.last - 1];
			this.#sent--;
		} else {
			this.#answered = request;
			for (const { reject } of this.#remove(({ first }) => first <= request)) reject(problem);
		}
	}
}
