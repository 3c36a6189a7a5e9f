/**
 * @file A turn of the scan about its vertical axis, as an animated PNG.
 * That is the frames' compressed data as they are, in chunks of other names: they are put together here without a pixel being touched.
 */
import { Problem, frame } from './api.js';
import { renderRequest } from './request.js';

/** @import {State} from './state.js' */
/** @import {Size} from './request.js' */
/** @typedef {{name: string, data: Uint8Array}} Chunk */

/** Bytes before the first chunk; and of a chunk what is no data: length, name, checksum. */
const SIGNATURE = [137, 80, 78, 71, 13, 10, 26, 10];
const FRAME_OF_CHUNK = 12;

/**
 * Asks for the frames one after another, so that whoever looks at a scan meanwhile has their share.
 * @param {State} state @param {Size} size @param {'standard' | 'high'} quality
 * @param {{frames: number, seconds: number}} turn
 * @param {(done: number) => void} progress @param {AbortSignal} signal
 * @returns {Promise<Blob>}
 */
export async function turntable(state, size, quality, { frames, seconds }, progress, signal) {
	const pngs = [];
	for (let i = 0; i < frames; i++) {
		progress(i);
		const camera = { ...state.camera, azimuth: state.camera.azimuth + (360 * i) / frames };
		pngs.push(await patient(state.volume, renderRequest({ ...state, camera }, size, quality), signal));
	}
	return new Blob(animated(pngs, (1000 * seconds) / frames), { type: 'image/png' });
}

/** Waits where the service is busy: a long turn is not given up for a moment's crowd. @param {string} id @param {object} request @param {AbortSignal} signal */
async function patient(id, request, signal) {
	for (;;) {
		try {
			return new Uint8Array(await (await frame(id, request, signal)).blob.arrayBuffer());
		} catch (error) {
			if (!(error instanceof Problem) || error.kind !== 'busy') throw error;
			await new Promise((resolve) => setTimeout(resolve, 1000 * error.retryAfter));
			signal.throwIfAborted();
		}
	}
}

/** @param {Uint8Array[]} pngs of one size and kind @param {number} delay ms @returns {BlobPart[]} */
export function animated(pngs, delay) {
	const [first] = pngs;
	const { width, height } = sizeOf(first);
	let sequence = 0;
	const control = () => chunk('fcTL', numbers(sequence++, width, height, 0, 0), shorts(Math.round(delay), 1000), new Uint8Array(2));
	const head = chunksOf(first).filter(({ name }) => name !== 'IDAT' && name !== 'IEND').map(({ name, data }) => chunk(name, data));
	const body = pngs.flatMap((png, i) => {
		const data = chunksOf(png).filter(({ name }) => name === 'IDAT');
		return [control(), ...data.map((part) => (i === 0 ? chunk('IDAT', part.data) : chunk('fdAT', numbers(sequence++), part.data)))];
	});
	return [new Uint8Array(SIGNATURE), ...head, chunk('acTL', numbers(pngs.length, 0)), ...body, chunk('IEND')];
}

/** @param {Uint8Array} bytes */
const viewOf = (bytes) => new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);

/** @param {Uint8Array} png @returns {Size} */
const sizeOf = (png) => ({ width: viewOf(png).getUint32(16), height: viewOf(png).getUint32(20) });

/** @param {Uint8Array} png @returns {Chunk[]} */
function chunksOf(png) {
	const view = viewOf(png);
	const chunks = [];
	for (let at = SIGNATURE.length; at < png.length; ) {
		const length = view.getUint32(at);
		chunks.push({ name: String.fromCharCode(...png.subarray(at + 4, at + 8)), data: png.subarray(at + 8, at + 8 + length) });
		at += FRAME_OF_CHUNK + length;
	}
	return chunks;
}

/** @param {string} name @param {Uint8Array[]} parts */
function chunk(name, ...parts) {
	const length = parts.reduce((sum, part) => sum + part.length, 0);
	const bytes = new Uint8Array(FRAME_OF_CHUNK + length);
	bytes.set(numbers(length));
	bytes.set(Array.from(name, (letter) => letter.charCodeAt(0)), 4);
	let at = 8;
	for (const part of parts) {
		bytes.set(part, at);
		at += part.length;
	}
	viewOf(bytes).setUint32(at, checksum(bytes.subarray(4, at)));
	return bytes;
}

/** Big endian, four bytes each. @param {number[]} values */
function numbers(...values) {
	const bytes = new Uint8Array(4 * values.length);
	values.forEach((value, i) => viewOf(bytes).setUint32(4 * i, value));
	return bytes;
}

/** @param {number[]} values */
function shorts(...values) {
	const bytes = new Uint8Array(2 * values.length);
	values.forEach((value, i) => viewOf(bytes).setUint16(2 * i, value));
	return bytes;
}

const CRC = Uint32Array.from({ length: 256 }, (_, byte) => {
	let crc = byte;
	for (let bit = 0; bit < 8; bit++) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
	return crc;
});

/** CRC-32, as PNG has it. @param {Uint8Array} bytes */
function checksum(bytes) {
	let crc = 0xffffffff;
	for (const byte of bytes) crc = (crc >>> 8) ^ CRC[(crc ^ byte) & 255];
	return (crc ^ 0xffffffff) >>> 0;
}
