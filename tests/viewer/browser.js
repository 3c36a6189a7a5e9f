/** @file A browser, and what tests see of a page: its picture, its errors, where its requests go. */
import { chromium } from 'playwright-core';

const EXECUTABLE = process.env.CHROMIUM ?? '/usr/bin/chromium';
const FLAGS = ['--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync'];

/** @typedef {import('playwright-core').Page} Page */
/** @typedef {{page: Page, errors: string[], strangers: string[], close: () => Promise<void>}} Visit */

export const launch = () => chromium.launch({ executablePath: EXECUTABLE, args: FLAGS });

/**
 * A fresh visitor's page.
 * @param {import('playwright-core').Browser} browser @param {string} url
 * @param {import('playwright-core').BrowserContextOptions} [options]
 * @returns {Promise<Visit>}
 */
export async function visit(browser, url, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1000, height: 700 }, ...options });
  const page = await context.newPage();
  /** @type {string[]} */ const errors = [];
  /** @type {string[]} */ const strangers = [];
  const { host } = new URL(url);
  // Of the warnings one is about the tests' own looks at pixels.
  const matters = (/** @type {string} */ type, /** @type {string} */ text) => type === 'error' || (type === 'warning' && !text.includes('willReadFrequently'));
  page.on('console', (message) => matters(message.type(), message.text()) && errors.push(message.text()));
  page.on('pageerror', (error) => errors.push(String(error)));
  page.on('request', (request) => {
    const at = new URL(request.url());
    if (at.protocol !== 'blob:' && at.host !== host) strangers.push(request.url());
  });
  await page.goto(url);
  return { page, errors, strangers, close: () => context.close() };
}

/** Waits until the picture is that of the newest view, at rest. @param {Page} page @param {string} [stage] */
export async function rested(page, stage = 'standard') {
  await page.locator(`#view[data-stage="${stage}"]`).waitFor({ timeout: 60_000 });
}

/** The picture's pixels, as a hash; and how many of them show something. @param {Page} page @returns {Promise<{hash: string, shown: number}>} */
export async function picture(page) {
  return page.evaluate(async () => {
    const canvas = /** @type {HTMLCanvasElement} */ (document.querySelector('#picture'));
    // The next frame that the browser paints has what was last asked for.
    await new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)));
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext('2d'));
    const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
    // What is in sight is the canvas where its style puts it.
    const { transform } = canvas.style;
    let [hash, shown] = [2166136261, 0];
    for (let i = 0; i < data.length; i += 4) {
      for (let c = 0; c < 4; c++) hash = Math.imul(hash ^ data[i + c], 16777619);
      if (data[i] + data[i + 1] + data[i + 2] > 30) shown++;
    }
    return { hash: `${canvas.width}x${canvas.height} ${(hash >>> 0).toString(16)} ${transform}`, shown: shown / (data.length / 4) };
  });
}

/** What a person sees of the picture, without what lies on it. @param {Page} page @returns {Promise<Buffer>} a PNG */
export async function seen(page) {
  const hidden = (/** @type {boolean} */ yes) => page.evaluate((hide) => {
    for (const over of document.querySelectorAll('#overlay, #tools, #messages')) over.toggleAttribute('hidden', hide);
  }, yes);
  await hidden(true);
  const png = await page.locator('#view').screenshot();
  await hidden(false);
  return png;
}

/** How far two pictures of one size are apart: the mean over all components and the greatest difference, of 255. @param {Page} page @param {Buffer[]} pngs @returns {Promise<{mean: number, most: number}>} */
export async function apart(page, ...pngs) {
  return page.evaluate(async (encoded) => {
    const [a, b] = await Promise.all(encoded.map(async (base64) => {
      const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
      const bitmap = await createImageBitmap(new Blob([bytes]));
      const context = /** @type {OffscreenCanvasRenderingContext2D} */ (new OffscreenCanvas(bitmap.width, bitmap.height).getContext('2d'));
      context.drawImage(bitmap, 0, 0);
      return context.getImageData(0, 0, bitmap.width, bitmap.height).data;
    }));
    if (a.length !== b.length) throw new Error(`${a.length} and ${b.length} components`);
    let [sum, most] = [0, 0];
    a.forEach((value, i) => {
      sum += Math.abs(value - b[i]);
      most = Math.max(most, Math.abs(value - b[i]));
    });
    return { mean: sum / a.length, most };
  }, pngs.map((png) => png.toString('base64')));
}

/** Drags from one place of an element to another, as a hand does. @param {Page} page @param {string} selector @param {[number, number]} from parts of its sides @param {[number, number]} to */
export async function drag(page, selector, from, to) {
  const box = await page.locator(selector).boundingBox();
  if (!box) throw new Error(`${selector} is not in sight`);
  const at = (/** @type {[number, number]} */ [x, y]) => /** @type {const} */ ([box.x + x * box.width, box.y + y * box.height]);
  await page.mouse.move(...at(from));
  await page.mouse.down();
  await page.mouse.move(...at(to), { steps: 12 });
  await page.mouse.up();
}
