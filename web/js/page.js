/** @file What belongs to the page and not to a scan: its colours, its tabs, what a person prefers. */
import { byId, el, icon, iconButton } from './dom.js';

/** @import {Tool} from './input.js' */

/** @typedef {'auto' | 'light' | 'dark'} Theme */

/** @type {{name: Theme, label: string, icon: string}[]} */
const THEMES = [
	{ name: 'auto', label: 'Colours as the system has them', icon: 'theme-auto' },
	{ name: 'light', label: 'Light colours', icon: 'theme-light' },
	{ name: 'dark', label: 'Dark colours', icon: 'theme-dark' },
];

/** @type {[Tool, string, string][]} */
const TOOLS = [
	['orbit', 'Turn', ''], ['pan', 'Move', ' (Shift)'], ['zoom', 'Zoom', ' (wheel)'], ['roll', 'Roll', ' (Alt)'], ['window', 'Window and level', ' (right button)'],
];

/** What was kept under a name; private windows keep nothing. @param {string} name */
export function kept(name) {
	try {
		return localStorage.getItem(`shearwarp.${name}`);
	} catch {
		return null;
	}
}

/** @param {string} name @param {string} value */
export function keep(name, value) {
	try {
		localStorage.setItem(`shearwarp.${name}`, value);
	} catch {
		// It is a convenience only.
	}
}

/** A button that goes round the themes. */
export function themeButton() {
	const show = (/** @type {number} */ index) => {
		const theme = THEMES[index];
		document.documentElement.dataset.theme = theme.name;
		button.replaceChildren(icon(theme.icon));
		button.setAttribute('aria-label', `Theme: ${theme.label.toLowerCase()}`);
		button.title = theme.label;
	};
	let index = Math.max(0, THEMES.findIndex(({ name }) => name === kept('theme')));
	const button = iconButton('', '', () => {
		index = (index + 1) % THEMES.length;
		keep('theme', THEMES[index].name);
		show(index);
	});
	show(index);
	return button;
}

/**
 * Tabs as ARIA wants them: one is in the tab order, arrows go to the others.
 * @param {HTMLElement} list @param {HTMLElement} place
 * @param {{name: string, label: string, content: HTMLElement}[]} tabs @param {() => void} shown
 * @returns {(name: string) => void} opens one
 */
export function tabs(list, place, tabs, shown) {
	const buttons = tabs.map(({ name, label }) => el('button', { type: 'button', role: 'tab', id: `tab-${name}`, 'aria-controls': `panel-${name}`, onclick: () => open(name) }, label));
	const panels = tabs.map(({ name, content }) => el('div', { role: 'tabpanel', id: `panel-${name}`, 'aria-labelledby': `tab-${name}` }, content));
	const open = (/** @type {string} */ name) => {
		tabs.forEach((tab, i) => {
			const selected = tab.name === name;
			buttons[i].setAttribute('aria-selected', String(selected));
			buttons[i].tabIndex = selected ? 0 : -1;
			panels[i].hidden = !selected;
		});
		place.scrollTop = 0;
		shown();
	};
	list.addEventListener('keydown', (event) => {
		const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
		if (!step) return;
		const now = buttons.findIndex((button) => button.tabIndex === 0);
		const next = (now + step + tabs.length) % tabs.length;
		open(tabs[next].name);
		buttons[next].focus();
	});
	list.replaceChildren(...buttons);
	place.replaceChildren(...panels);
	return open;
}

/** What a plain drag on the picture does, for those who have no modifier keys at hand. @param {(tool: Tool) => void} choose */
export function tools(choose) {
	byId('tools').append(...TOOLS.map(([tool, label, keys]) => el('label', { title: label + keys },
		el('input', { type: 'radio', name: 'tool', checked: tool === 'orbit', onchange: () => choose(tool) }), icon(tool), el('span', { class: 'unseen' }, label))));
}
