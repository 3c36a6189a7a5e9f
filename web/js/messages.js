/** @file What stands between a person and the picture, in words, with what they can do. The last picture stays below it. */
import { el, icon } from './dom.js';

/** @import {Problem} from './api.js' */

const TITLES = {
	busy: 'The service is busy',
	loading: 'The scan is being loaded',
	gone: 'The service does not answer',
	refused: 'The service refuses this',
	missing: 'This scan is not there',
	failed: 'This did not work',
};

export class Messages {
	#countdown = 0;
	#shown = '';
	/** Whether what is shown may pass by itself. */ #passing = false;

	/** @param {HTMLElement} place @param {HTMLElement} spoken a polite live region @param {() => void} retry */
	constructor(place, spoken, retry) {
		this.place = place;
		this.spoken = spoken;
		this.retry = retry;
	}

	/** @param {Problem | null} problem `null`: all is well again */
	show(problem) {
		const key = problem ? `${problem.kind} ${problem.message}` : '';
		if (!problem && this.#shown === '') return;
		clearInterval(this.#countdown);
		if (!problem) {
			this.place.replaceChildren();
			if (this.#passing) this.say('The service answers again.');
		} else {
			const wait = el('p', { class: 'wait' });
			const again = el('button', { type: 'button', onclick: () => this.retry() }, 'Try now');
			const body = el('div', {}, el('strong', {}, TITLES[problem.kind]), ...this.#explained(problem), ...(problem.passing ? [wait] : []));
			this.place.replaceChildren(el('div', { class: `message ${problem.kind}`, role: key === this.#shown ? undefined : 'alert' },
				icon(problem.passing ? 'wait' : 'alert'), body, ...(problem.passing ? [again] : [])));
			if (problem.passing) this.#count(wait, problem.retryAfter);
		}
		this.#shown = key;
		this.#passing = problem?.passing ?? false;
	}

	/** @param {Problem} problem */
	#explained({ kind, message, errors }) {
		if (errors.length > 0)
			return [el('ul', {}, ...errors.map(({ pointer, detail }) => el('li', {}, el('code', {}, pointer || '/'), ` ${detail}`)))];
		if (kind === 'busy') return [el('p', {}, 'Others are rendering too; your view is next in turn.')];
		if (kind === 'gone') return [el('p', {}, 'It may be restarting. What you see stays.')];
		return [el('p', {}, message)];
	}

	/** @param {HTMLElement} place @param {number} seconds */
	#count(place, seconds) {
		let left = Math.ceil(seconds);
		const tell = () => (place.textContent = left > 0 ? `Trying again in ${left} s.` : 'Trying again…');
		tell();
		this.#countdown = setInterval(() => {
			left--;
			tell();
		}, 1000);
	}

	/** A short word about something that worked. @param {string} text */
	say(text) {
		this.spoken.textContent = text;
		this.spoken.classList.remove('fresh');
		// A new animation needs a new style in between.
		void this.spoken.offsetWidth;
		this.spoken.classList.add('fresh');
	}
}
