/**
 * @file What the service is asked over HTTP, and what can go wrong with it.
 * A failure becomes a {@link Problem} that says what a person can do: wait (busy, loading, gone) or change something (refused,
 * missing, failed). Addresses are relative: a proxy may serve the viewer under any path.
 */
import { framePath } from './request.js';

/** @typedef {{id: string, name: string, modality?: string, status: 'loading' | 'failed' | 'ready', detail?: string}} VolumeHead */
/**
 * @typedef {object} VolumeFacts of a ready volume
 * @property {[number, number, number]} dimensions
 * @property {[number, number, number]} spacing
 * @property {[number, number, number]} origin
 * @property {number[]} direction
 * @property {string} scalar_type
 * @property {number} components
 * @property {[number, number]} value_range
 * @property {string} default_preset
 * @property {{format: string, non_finite: number, quantized: boolean, volumes_left_out: number}} import
 * @property {Record<string, number>} bytes
 */
/** @typedef {VolumeHead & Partial<VolumeFacts>} Volume */
/** @typedef {VolumeHead & VolumeFacts} ReadyVolume */
/** @typedef {{name: string, title: string, description: string, modality: string[], values: 'file' | 'range', shading: boolean, transfer_function: import('./state.js').TransferFunction}} Preset */
/** @typedef {{bins: number, min: number, max: number, counts: number[]}} Histogram */
/** @typedef {{preset: string, shading: boolean, transfer_function: import('./state.js').TransferFunction}} Fitted */
/** @typedef {{blob: Blob, stages: Record<string, number>, algorithm: string, warp?: number[], downloaded: number, drawn?: () => void}} FrameAnswer `warp`: of an intermediate image (warp.js); `drawn` tells the service that there is room for another */
/** @typedef {'busy' | 'loading' | 'gone' | 'refused' | 'missing' | 'failed'} Kind */

/** Why there is no answer, and in which way that may change. */
export class Problem extends Error {
	/** @param {Kind} kind @param {string} message @param {{retryAfter?: number, errors?: {pointer: string, detail: string}[]}} [more] */
	constructor(kind, message, { retryAfter = 1, errors = [] } = {}) {
		super(message);
		this.kind = kind;
		/** Seconds. */
		this.retryAfter = retryAfter;
		this.errors = errors;
	}

	/** Whether the same request may succeed later. */
	get passing() {
		return this.kind === 'busy' || this.kind === 'loading' || this.kind === 'gone';
	}
}

/** @param {string} path @param {RequestInit} [init] @returns {Promise<Response>} a good one @throws {Problem} or an AbortError */
async function ask(path, init) {
	let response;
	try {
		response = await fetch(path, init);
	} catch (error) {
		if (init?.signal?.aborted) throw error;
		throw new Problem('gone', 'The service does not answer.');
	}
	if (response.ok) return response;
	throw await problemOf(response);
}

/** @param {Response} response */
async function problemOf(response) {
	const body = await response.json().catch(() => ({}));
	return problemIn({ ...body, status: response.status }, Number(response.headers.get('Retry-After')) || 1);
}

/** What the service says went wrong (RFC 9457). @param {any} body @param {number} [retryAfter] seconds */
export function problemIn(body, retryAfter = 1) {
	const detail = String(body.detail ?? `status ${body.status}`);
	const of = (/** @type {Kind} */ kind) => new Problem(kind, detail, { retryAfter, errors: body.errors ?? [] });
	if (body.status === 503) return of(String(body.type).endsWith(':loading') ? 'loading' : 'busy');
	if (body.status === 422) return of('refused');
	// What a proxy says when the service behind it is down.
	if (body.status === 502) return of('gone');
	return of(body.status === 404 ? 'missing' : 'failed');
}

/** @param {string} path @param {AbortSignal} [signal] */
const json = async (path, signal) => (await ask(path, { signal })).json();

/** @param {string} id */
const volumePath = (id) => `v1/volumes/${encodeURIComponent(id)}`;

/** @returns {Promise<Volume[]>} */
export const listVolumes = async () => (await json('v1/volumes')).volumes;

/** @returns {Promise<Preset[]>} */
export const listPresets = async () => (await json('v1/presets')).presets;

/** @param {string} id @param {AbortSignal} [signal] @returns {Promise<Histogram>} */
export const histogram = (id, signal) => json(`${volumePath(id)}/histogram?bins=1024`, signal);

/** What a preset, or none, is on this scan. @param {string} id @param {string | null} preset @param {AbortSignal} [signal] @returns {Promise<Fitted>} */
export const fitted = (id, preset, signal) =>
	json(`${volumePath(id)}/transfer-function${preset ? `?preset=${encodeURIComponent(preset)}` : ''}`, signal);

/** @param {string} id @param {object} request @param {AbortSignal} signal @returns {Promise<FrameAnswer>} */
export async function frame(id, request, signal) {
	const headers = { 'Content-Type': 'application/json' };
	const response = await ask(framePath(id), { method: 'POST', headers, body: JSON.stringify(request), signal });
	const arrived = performance.now();
	const blob = await body(response, signal);
	const stages = readTimings(response.headers.get('Server-Timing') ?? '');
	const algorithm = response.headers.get('X-Render-Algorithm') ?? '';
	const warp = response.headers.get('X-Image-Warp')?.split(',').map(Number);
	return { blob, stages, algorithm, warp, downloaded: performance.now() - arrived };
}

/** A small still frame, to the side of what is being looked at. @param {string} id @param {Record<string, any>} query @param {AbortSignal} signal */
export async function thumbnail(id, query, signal) {
	const path = `${framePath(id)}.png?${new URLSearchParams(query)}`;
	const response = await ask(path, { signal, priority: 'low' });
	return body(response, signal);
}

/** @param {Response} response @param {AbortSignal} signal */
async function body(response, signal) {
	try {
		return await response.blob();
	} catch (error) {
		if (signal.aborted) throw error;
		throw new Problem('gone', 'The connection broke.');
	}
}

/** `queue;dur=0.1, total;dur=9.4` as numbers, ms. @param {string} header @returns {Record<string, number>} */
export function readTimings(header) {
	const stages = header.matchAll(/([a-z-]+);dur=([0-9.]+)/g);
	return Object.fromEntries(Array.from(stages, ([, name, ms]) => [name, Number(ms)]));
}
