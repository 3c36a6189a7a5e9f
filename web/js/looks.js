/**
 * @file Which looks a scan is offered.
 * Presets for CT are in Hounsfield units, and many files are not: "Skin" is then a solid box. The scan's own look tells how its
 * units lie: it is one of the presets, shifted, and the others are shifted alike; or they mean nothing, and two looks are drawn from it.
 */
import { short } from './transfer.js';

/** @import {Preset, ReadyVolume, Fitted} from './api.js' */
/** @import {TransferFunction} from './state.js' */
/** @typedef {{name: string, title: string, description: string, transfer: null | string | TransferFunction, shading: boolean | null}} Offer `shading` as for the state */

/** What the service calls a look that is none of the presets. */
export const AUTOMATIC = 'automatic';

/**
 * Those meant for such a scan, and the rest.
 * @param {Preset[]} presets @param {ReadyVolume} volume @param {Fitted | null} automatic the scan's own look where it is none of the presets
 * @returns {{fitting: Offer[], others: Offer[]}}
 */
export function looksFor(presets, volume, automatic) {
	const width = (volume.value_range[1] - volume.value_range[0]) / 100;
	const shift = automatic && shiftOf(presets, automatic.transfer_function);
	const unitless = automatic !== null && shift === null;
	/** @type {Offer[]} */
	const own = [{ name: '', title: 'Automatic', description: 'What suits this scan, by its kind and its histogram.', transfer: null, shading: null }];
	if (unitless) own.push(...drawnFrom(automatic.transfer_function, width));
	const offers = presets.map((preset) => ({
		fits: fits(preset, volume) && !(unitless && preset.values === 'file'),
		offer: shift !== null && preset.values === 'file' ? shifted(preset, shift, width) : named(preset),
	}));
	const those = (/** @type {boolean} */ wanted) => offers.filter((one) => one.fits === wanted).map(({ offer }) => offer);
	return { fitting: [...own, ...those(true)], others: those(false) };
}

/** @param {Preset} preset @returns {Offer} */
const named = ({ name, title, description }) => ({ name, title, description, transfer: name, shading: null });

/** Whether a preset is meant for such a scan, as far as the scan says what it is. @param {Preset} preset @param {ReadyVolume} volume */
function fits({ name, modality }, volume) {
	const words = `${volume.modality ?? ''} ${(volume.default_preset ?? '').slice(0, 3)}`.toUpperCase();
	const known = /CT|MR/.test(words);
	return name === volume.default_preset || modality.length === 0 || !known || modality.some((word) => words.includes(word));
}

/** By how much the scan's values are above those that presets speak of; `null` where its look is no preset. @param {Preset[]} presets @param {TransferFunction} own */
function shiftOf(presets, own) {
	for (const { values, transfer_function: { points } } of presets) {
		if (values !== 'file' || points.length !== own.points.length) continue;
		const shift = own.points[0].value - points[0].value;
		const alike = points.every(({ value, opacity, color }, i) =>
			Math.abs(own.points[i].value - value - shift) < 1e-3 && own.points[i].opacity === opacity && own.points[i].color === color);
		if (alike) return shift;
	}
	return null;
}

/** @param {Preset} preset @param {number} shift @param {number} width @returns {Offer} */
function shifted({ name, title, description, shading, transfer_function: transfer }, shift, width) {
	const points = transfer.points.map((point) => ({ ...point, value: short(point.value + shift, width) }));
	return { name, title, description, transfer: { ...transfer, points }, shading };
}

/** From where the look first shows something, and where it becomes opaque. @param {TransferFunction} own @param {number} width @returns {Offer[]} */
function drawnFrom({ points, ...rest }, width) {
	const most = Math.max(...points.map(({ opacity }) => opacity));
	const full = points.findIndex(({ opacity }) => opacity === most);
	if (full < 1) return [];
	const [last, opaque] = [points[points.length - 1], Math.max(0.9, most)];
	const of = (/** @type {TransferFunction['points']} */ ...some) =>
		({ ...rest, points: some.map((point) => ({ ...point, value: short(point.value, width) })) });
	// Its first colours are those of a veil. Half way between the first two points: beyond, a surface would swallow the next material's edge.
	const edge = (points[0].value + points[1].value) / 2;
	const [skin, flesh] = [points[Math.max(0, full - 2)].color, points[full - 1].color];
	const surface = of({ ...points[0], opacity: 0, color: skin }, { value: edge, opacity: opaque, color: skin }, { ...last, opacity: opaque, color: flesh });
	const dense = of({ ...points[full - 1], opacity: 0 }, ...points.slice(full));
	return [
		{ name: 'surface', title: 'Surface', description: 'Everything that is no background, opaque.', transfer: surface, shading: true },
		{ name: 'dense', title: 'Dense parts', description: 'The densest of the scan on its own: bone, metal, stone.', transfer: dense, shading: true },
	];
}
