/** @file Elements, made in one call. */

const SVG = 'http://www.w3.org/2000/svg';

/** @typedef {Record<string, string | number | boolean | ((event: any) => void) | undefined>} Attributes `on…` listen; `true` is an empty attribute, `false` none */
/** @typedef {(Node | string)[]} Children */

/** @template {Element} E @param {E} element @param {Attributes} attributes @param {Children} children */
function filled(element, attributes, children) {
	for (const [name, value] of Object.entries(attributes)) {
		if (typeof value === 'function') element.addEventListener(name.slice(2), value);
		else if (value !== undefined && value !== false) element.setAttribute(name, value === true ? '' : String(value));
	}
	element.append(...children);
	return element;
}

/** @template {keyof HTMLElementTagNameMap} K @param {K} tag @param {Attributes} [attributes] @param {Children} children @returns {HTMLElementTagNameMap[K]} */
export const el = (tag, attributes = {}, ...children) => filled(document.createElement(tag), attributes, children);

/** @template {keyof SVGElementTagNameMap} K @param {K} tag @param {Attributes} [attributes] @param {Children} children @returns {SVGElementTagNameMap[K]} */
export const svg = (tag, attributes = {}, ...children) => filled(document.createElementNS(SVG, tag), attributes, children);

/**
 * Takes icons.svg into the page. A reference into another file is asked for anew by each icon: what a service that
 * is gone cannot answer, just when there is a message about it.
 */
export async function takeIcons() {
	const response = await fetch('icons.svg');
	const { documentElement } = new DOMParser().parseFromString(await response.text(), 'image/svg+xml');
	documentElement.classList.add('unseen');
	documentElement.setAttribute('aria-hidden', 'true');
	document.body.append(documentElement);
}

/** A symbol of icons.svg; its meaning must stand beside it or in its button's label. @param {string} name */
export const icon = (name) => svg('svg', { class: 'icon', viewBox: '0 0 24 24', 'aria-hidden': 'true' }, svg('use', { href: `#icon-${name}` }));

/** @param {string} name @param {string} label @param {(event: any) => void} onclick @param {Attributes} [more] */
export const iconButton = (name, label, onclick, more = {}) =>
	el('button', { type: 'button', class: 'icon-button', 'aria-label': label, title: label, onclick, ...more }, icon(name));

/** Where arrow keys point to, y up. @type {Record<string, [number, number]>} */
export const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** The element of index.html with this id. @param {string} id @returns {HTMLElement} */
export function byId(id) {
	const element = document.getElementById(id);
	if (!element) throw new Error(`index.html has no #${id}`);
	return element;
}
