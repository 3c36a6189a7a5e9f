/**
 * @file The transfer function behind the state, its history, and windowing.
 * The state may name a preset or nothing at all; an editor needs points. {@link Look} asks the service what the
 * name stands for, so that the first edit starts from what is seen.
 */
import { fitted } from './api.js';
import { short, windowOf, windowed } from './transfer.js';

/** @import {State, TransferFunction, Blend, Store, Window} from './state.js' */
/** @import {ReadyVolume} from './api.js' */
/** @typedef {Pick<State, 'transfer' | 'shading'>} Past */

/** Steps that can be undone. */
const MEMORY = 100;

export class Look {
	/** What is seen, as points; `null` while it is not known. @type {TransferFunction | null} */ current = null;
	/** Whether frames are shaded unless told. */ shaded = true;
	/** @type {Past[]} */ #past = [];
	/** @type {Past[]} */ #future = [];
	#open = false;
	#travelling = false;
	#asking = new AbortController();
	/** Told whether it is another look altogether and no edit. @type {((another: boolean) => void)[]} */ onChange = [];

	/** @param {Store} store @param {() => ReadyVolume | null} volume */
	constructor(store, volume) {
		this.store = store;
		this.volume = volume;
		store.subscribe((state, before, moving) => {
			if (state.volume !== before.volume) [this.#past, this.#future] = [[], []];
			else if (state.transfer !== before.transfer && !this.#travelling) this.#remember(before, moving);
			if (state.volume !== before.volume || state.transfer !== before.transfer) this.refresh();
		});
	}

	/** Finds out what the state's transfer function is. */
	async refresh() {
		const { state: { transfer, volume: id } } = this.store;
		this.#asking.abort();
		if (transfer !== null && typeof transfer !== 'string') {
			this.current = transfer;
			return this.#told(false);
		}
		if (this.volume()?.id !== id) return;
		const { signal } = (this.#asking = new AbortController());
		try {
			const answer = await fitted(id, transfer, signal);
			if (signal.aborted) return;
			[this.current, this.shaded] = [this.#tidy(answer.transfer_function), answer.shading];
		} catch {
			// The frame that is asked for at the same time says what is wrong.
			if (signal.aborted) return;
			this.current = null;
		}
		this.#told(true);
	}

	/** Fitted values have all digits that a number can; links should not. @param {TransferFunction} transfer @returns {TransferFunction} */
	#tidy(transfer) {
		const [low, high] = this.volume()?.value_range ?? [0, 1];
		const points = transfer.points.map((point) => ({ ...point, value: short(point.value, (high - low) / 100) }));
		return { ...transfer, points };
	}

	/** @param {boolean} another */
	#told(another) {
		for (const listener of this.onChange) listener(another);
	}

	/** Replaces what is seen. @param {TransferFunction} transfer @param {boolean} [moving] */
	edit(transfer, moving = false) {
		// Requests with points of their own are shaded unless told.
		const shading = this.store.state.shading ?? (this.shaded ? null : false);
		this.store.set({ transfer, shading }, moving);
		if (!moving) this.commit();
	}

	/** The gesture is over: what comes next is another step. */
	commit() {
		this.#open = false;
	}

	/** @param {State} before @param {boolean} moving */
	#remember({ transfer, shading }, moving) {
		if (!this.#open) this.#past.push({ transfer, shading });
		if (this.#past.length > MEMORY) this.#past.shift();
		this.#future = [];
		this.#open = moving;
	}

	get canUndo() {
		return this.#past.length > 0;
	}

	get canRedo() {
		return this.#future.length > 0;
	}

	undo() {
		this.#travel(this.#past, this.#future);
	}

	redo() {
		this.#travel(this.#future, this.#past);
	}

	/** @param {Past[]} from @param {Past[]} to */
	#travel(from, to) {
		const then = from.pop();
		if (!then) return;
		const { transfer, shading } = this.store.state;
		to.push({ transfer, shading });
		this.#travelling = true;
		this.store.set(then);
		this.#travelling = false;
		this.commit();
	}

	/** The values that the picture tells apart: the points', or a projection's. @returns {Window | null} */
	get window() {
		const range = this.volume()?.value_range;
		const { blend, window } = this.store.state;
		if (!range) return null;
		const width = range[1] - range[0] || 1;
		if (blend !== 'composite') return window ?? { center: (range[0] + range[1]) / 2, width };
		return this.current && windowOf(this.current, width / 1000);
	}

	/**
	 * What a projection begins with: the scan's range, which requests leave out. Averages are mostly air; they lie in its
	 * lowest quarter. @param {Blend} blend @returns {Window | null}
	 */
	firstWindow(blend) {
		const range = this.volume()?.value_range;
		if (blend !== 'average' || !range) return null;
		const width = short((range[1] - range[0]) / 4, range[1] - range[0]) || 1;
		return { center: short(range[0] + width / 2, width), width };
	}

	/** @param {Window} to @param {boolean} [moving] */
	setWindow(to, moving = false) {
		const from = this.window;
		if (!from || !(to.width > 0)) return;
		const window = { center: short(to.center, to.width), width: short(to.width, to.width) };
		if (this.store.state.blend !== 'composite') this.store.set({ window }, moving);
		else if (this.current) this.edit(windowed(this.current, from, window), moving);
	}

	/** Windowing by a drag on the picture: sideways the width, up and down the level, as on a workstation. @param {number} dx @param {number} dy */
	drag(dx, dy) {
		const from = this.window;
		const range = this.volume()?.value_range;
		if (!from || !range) return;
		const width = Math.max((range[1] - range[0]) / 1000, from.width * Math.exp(dx));
		this.setWindow({ center: from.center - (dy * (range[1] - range[0])) / 4, width }, true);
	}
}
