/**
 * @file All that the viewer shows, in one plain object.
 * Modules never talk to each other: each reads the state, changes it through the store, and listens. So links are possible, and
 * undo. What a default stands for is not in it: `transfer: null` is the scan's own look.
 */

/** @import {Vector} from './vector.js' */
/** @typedef {{value: number, opacity: number, color: string}} ControlPoint */
/** @typedef {{value: number, opacity: number}} GradientPoint */

/**
 * @typedef {object} TransferFunction
 * @property {ControlPoint[]} points ascending by value
 * @property {number} [opacity_distance] mm
 * @property {GradientPoint[]} [gradient_opacity]
 */

/** @typedef {{direction: Vector, intensity: number, shadows?: true}} Lamp */

/**
 * @typedef {object} Shading
 * @property {number} ambient
 * @property {number} diffuse
 * @property {number} specular
 * @property {number} shininess
 * @property {('headlight' | Lamp)[]} lights
 */

/**
 * @typedef {object} Camera An orbit, in the service's own terms (degrees, mm, LPS).
 * @property {'parallel' | 'perspective'} projection
 * @property {number} azimuth
 * @property {number} elevation
 * @property {number} roll
 * @property {number} zoom of the picture's shorter side
 * @property {number} fov_y
 * @property {Vector | null} target `null`: the scan's centre
 */

/** @typedef {{center: number, width: number}} Window */
/** @typedef {{point: Vector, normal: Vector}} Plane what lies where the normal points to is kept */
/** @typedef {{min: Vector, max: Vector}} Box */
/** @typedef {{center: Vector, radius: number, shows: 'fainter' | 'brightest' | string | TransferFunction}} Lens a ball in which the scan looks otherwise: as words say, or by a preset's name or points */
/** @typedef {'composite' | 'maximum' | 'minimum' | 'average'} Blend */
/** @typedef {'auto' | 'classified' | 'fast-classification' | 'preintegrated' | 'raycast'} Algorithm */
/** @typedef {'auto' | 'draft' | 'standard' | 'high'} Quality */

/**
 * @typedef {object} State
 * @property {string} volume
 * @property {Camera} camera
 * @property {null | string | TransferFunction} transfer `null`: the scan's own; a preset's name; or edited
 * @property {null | boolean | Shading} shading `null`: as the transfer function wants it
 * @property {Blend} blend
 * @property {Window | null} window of projections; `null`: the scan's range
 * @property {{front: number, density: number} | null} depthCueing
 * @property {Plane | null} plane that cuts the scan, world mm
 * @property {Box | null} box outside of which nothing is shown
 * @property {Lens | null} lens
 * @property {string} background `#rrggbb` or `transparent`
 * @property {Algorithm} algorithm
 * @property {Quality} quality of the picture at rest
 */

/** What requests leave to the service, spelled out where controls need it. @type {Shading} */
export const DEFAULT_SHADING = { ambient: 0.2, diffuse: 0.8, specular: 0.2, shininess: 20, lights: ['headlight'] };

/** @type {Camera} */
export const DEFAULT_CAMERA = {
	projection: 'parallel', azimuth: 30, elevation: 15, roll: 0, zoom: 1.25, fov_y: 30, target: null,
};

/** @type {State} */
export const DEFAULTS = {
	volume: '',
	camera: DEFAULT_CAMERA,
	transfer: null,
	shading: null,
	blend: 'composite',
	window: null,
	depthCueing: null,
	plane: null,
	box: null,
	lens: null,
	background: '#000000',
	algorithm: 'auto',
	quality: 'auto',
};

/** @typedef {(state: State, before: State, moving: boolean) => void} Listener */

/** The one place where the state changes. */
export class Store {
	/** @type {Set<Listener>} */
	#listeners = new Set();

	/** @param {State} state */
	constructor(state) {
		this.state = state;
	}

	/** @param {Partial<State>} patch @param {boolean} [moving] true within a gesture: more of the same will follow at once */
	set(patch, moving = false) {
		const before = this.state;
		this.state = { ...before, ...patch };
		for (const listener of this.#listeners) listener(this.state, before, moving);
	}

	/** @param {Partial<Camera>} patch @param {boolean} [moving] */
	setCamera(patch, moving = false) {
		this.set({ camera: { ...this.state.camera, ...patch } }, moving);
	}

	/** @param {Listener} listener */
	subscribe(listener) {
		this.#listeners.add(listener);
	}
}
