/** @file The viewer on a slow line: the last picture follows the pointer, the next one takes its place where it is. */
import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { renderRequest } from '../../web/js/request.js';
import { fromHash } from '../../web/js/link.js';
import { apart, launch, rested, seen, visit } from './browser.js';
import { Line } from './line.js';
import { Service } from './service.js';

/** @typedef {import('./browser.js').Page} Page */
/** @typedef {{what: 'moved' | 'laid' | 'painted' | 'frame', at: number}} Event */

/** Milliseconds, there and back. */
const DELAY = 100;
const VIEWS = {
  parallel: '#volume=demo&quality=standard&preset=ct-bone',
  perspective: '#volume=demo&quality=standard&preset=ct-bone&projection=perspective&azimuth=50&roll=20',
  transparent: '#volume=demo&quality=standard&background=transparent&zoom=3',
};

/** @type {import('playwright-core').Browser} */ let browser;
/** @type {Service} */ let service;
/** @type {Line} */ let line;

before(async () => {
  [browser, service] = await Promise.all([launch(), Service.start()]);
  line = await Line.open(service.address, DELAY);
});
after(async () => {
  await browser?.close();
  line?.close();
  await service?.stop();
});

/** A visitor at the far end whose picture rests and whose stream is open. @param {string} hash */
async function arrived(hash) {
  const visited = await visit(browser, 'about:blank');
  const { page } = visited;
  await page.addInitScript(() => {
    /** @type {Event[]} */ const log = [];
    Object.assign(window, { log });
    const note = (/** @type {Event['what']} */ what) => log.push({ what, at: performance.now() });
    window.WebSocket = class extends WebSocket {
      /** @param {string | URL} address */
      constructor(address) {
        super(address);
        this.addEventListener('message', ({ data }) => typeof data !== 'string' && note('frame'));
      }
    };
    // Before the viewer hears of it.
    window.addEventListener('pointermove', () => note('moved'), { capture: true });
    document.addEventListener('DOMContentLoaded', () => {
      const laid = () => {
        note('laid');
        // The task behind the next frame that is painted.
        requestAnimationFrame(() => setTimeout(() => note('painted')));
      };
      new MutationObserver(laid).observe(/** @type {Node} */ (document.querySelector('#picture')), { attributeFilter: ['style'] });
    });
  });
  const opened = page.waitForEvent('websocket');
  await page.goto(`${line.address}/${hash}`);
  await rested(page);
  await opened;
  await page.waitForTimeout(3 * DELAY);
  return visited;
}

/** What was noted since the last look. @param {Page} page @returns {Promise<Event[]>} */
const noted = (page) => page.evaluate(() => /** @type {any} */ (window).log.splice(0));

/** @param {number[]} values */
const median = (values) => values.sort((a, b) => a - b)[values.length >> 1];

test('on a line of 100 ms the picture is laid anew at once, before any frame of the move comes', async () => {
  const { page, errors, close } = await arrived(VIEWS.parallel);
  const box = await page.locator('#view').boundingBox();
  assert.ok(box);
  await page.mouse.move(box.x + 300, box.y + 300);
  await page.mouse.down();
  /** @type {Record<'laid' | 'painted' | 'frame', number[]>} */
  const took = { laid: [], painted: [], frame: [] };
  for (let i = 1; i <= 10; i++) {
    await noted(page);
    await page.mouse.move(box.x + 300 + 9 * i, box.y + 300 - 5 * i);
    await rested(page);
    const log = await noted(page);
    assert.deepEqual(log.slice(0, 3).map(({ what }) => what), ['moved', 'laid', 'painted']);
    for (const what of /** @type {const} */ (['laid', 'painted', 'frame'])) {
      const first = log.find((event) => event.what === what);
      assert.ok(first, `${what}, of ${JSON.stringify(log)}`);
      took[what].push(first.at - log[0].at);
    }
  }
  await page.mouse.up();
  // Timers end early by less than a millisecond.
  assert.ok(took.frame.every((ms) => ms > DELAY - 2), `the line is no shorter: ${took.frame}`);
  console.log(`from a move, ms: laid ${median(took.laid).toFixed(1)}, painted ${median(took.painted).toFixed(1)}, its own frame ${median(took.frame).toFixed(1)}`);
  assert.deepEqual(errors, []);
  await close();
});

test('a frame takes the place of the last one that was carried there, without a jump', async () => {
  const { page, close } = await arrived(VIEWS.parallel);
  const box = await page.locator('#view').boundingBox();
  assert.ok(box);
  const still = await seen(page);
  line.delay = 4000;
  await page.mouse.move(box.x + 300, box.y + 300);
  await page.mouse.down({ button: 'middle' });
  await page.mouse.move(box.x + 370, box.y + 260);
  await page.mouse.up({ button: 'middle' });
  const carried = await seen(page);
  assert.equal(await page.locator('#view').getAttribute('data-stage'), '', 'no frame of it yet');
  line.delay = DELAY;
  await rested(page);
  const [moved, jumped] = [await apart(page, still, carried), await apart(page, carried, await seen(page))];
  assert.ok(moved.mean > 5, JSON.stringify(moved));
  assert.ok(jumped.mean < 0.5, JSON.stringify(jumped));
  await close();
});

for (const [name, hash] of Object.entries(VIEWS)) {
  test(`what the page warps is what the service would have: ${name}`, async () => {
    const { page, errors, close } = await arrived(hash);
    assert.ok(await page.locator('#picture.unwarped').count(), 'the page has an intermediate image');
    const mine = await seen(page);
    const { width, height } = /** @type {{width: number, height: number}} */ (await page.locator('#view').boundingBox());
    const state = fromHash(hash);
    const body = JSON.stringify(renderRequest(state, { width, height }, 'standard'));
    const response = await fetch(`${service.address}/v1/volumes/demo/frame`, { method: 'POST', headers: { 'Content-Type': 'application/json' }, body });
    assert.deepEqual([response.status, response.headers.get('X-Image-Warp')], [200, null]);
    /** @type {Buffer} */ let theirs = Buffer.from(await response.arrayBuffer());
    if (state.background === 'transparent') {
      // Shown as a page would, over what the viewer has behind it.
      await page.evaluate(async (base64) => {
        const canvas = /** @type {HTMLCanvasElement} */ (document.querySelector('#picture'));
        const bitmap = await createImageBitmap(new Blob([Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0))]));
        Object.assign(canvas, { width: bitmap.width, height: bitmap.height, className: '' });
        canvas.getContext('2d')?.drawImage(bitmap, 0, 0);
        canvas.style.transform = 'none';
      }, theirs.toString('base64'));
      theirs = await seen(page);
    }
    const { mean, most } = await apart(page, mine, theirs);
    console.log(`${name}: ${mean.toFixed(3)} in the mean, ${most} at most, of 255`);
    // Transparent pictures are rounded to 8 bits twice, before the warp and after it.
    assert.ok(mean < (state.background === 'transparent' ? 1 : 0.5) && most < 40, `${mean} ${most}`);
    assert.deepEqual(errors, []);
    await close();
  });
}
