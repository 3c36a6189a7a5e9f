/**
 * @file The viewer in a real browser, against a real service with the built-in scan.
 *
 * Links ask for `standard`, so that a test knows when a picture is final. Pictures are compared by their
 * pixels: equal requests give equal frames.
 */
import assert from 'node:assert/strict';
import { execFile } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync } from 'node:fs';
import { createRequire } from 'node:module';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { promisify } from 'node:util';
import { drag, launch, picture, rested, visit } from './browser.js';
import { Service } from './service.js';

/** @typedef {import('./browser.js').Page} Page */

const CALM = '#volume=demo&quality=standard';
const FRAMES = '**/v1/volumes/demo/frame';

/** @type {import('playwright-core').Browser} */ let browser;
/** @type {Service} */ let service;
/** One with a single stream, for which a test may take. @type {Service} */ let narrow;

before(async () => {
  [browser, service, narrow] = await Promise.all([launch(), Service.start(), Service.start('127.0.0.1:0', { SHEARWARP_STREAM__MAX_STREAMS: '1' })]);
});
after(async () => {
  await browser?.close();
  await Promise.all([service?.stop(), narrow?.stop()]);
});

/** A visitor of a link whose picture is there. @param {string} [hash] @param {import('playwright-core').BrowserContextOptions} [options] @param {Service} [at] */
async function arrived(hash = CALM, options = {}, at = service) {
  const seen = await visit(browser, `${at.address}/${hash}`, options);
  await rested(seen.page);
  return seen;
}

/** What a page sends and gets over streams, from now on. @param {Page} page */
function streams(page) {
  /** @type {{opened: number, ended: number, sent: any[], frames: {header: any, picture: Buffer}[]}} */
  const seen = { opened: 0, ended: 0, sent: [], frames: [] };
  page.on('websocket', (socket) => {
    seen.opened++;
    socket.on('close', () => seen.ended++);
    socket.on('framesent', ({ payload }) => seen.sent.push(JSON.parse(String(payload))));
    socket.on('framereceived', ({ payload }) => {
      if (typeof payload === 'string') return;
      const length = payload.readUInt32LE(0);
      seen.frames.push({ header: JSON.parse(payload.toString('utf8', 4, 4 + length)), picture: payload.subarray(4 + length) });
    });
  });
  return seen;
}

/** @param {Page} page @param {() => boolean | Promise<boolean>} so */
async function until(page, so) {
  for (const start = Date.now(); !(await so()); await page.waitForTimeout(20)) assert.ok(Date.now() - start < 20_000, `never: ${so}`);
}

/** A visitor whose stream is open. @param {Service} [at] */
async function connected(at = service) {
  const seen = await visit(browser, 'about:blank');
  const stream = streams(seen.page);
  /** @type {import('playwright-core').Request[]} */ const posts = [];
  seen.page.on('request', (request) => request.method() === 'POST' && posts.push(request));
  await seen.page.goto(`${at.address}/${CALM}`);
  await rested(seen.page);
  await until(seen.page, () => stream.opened > 0);
  await seen.page.waitForTimeout(200);
  posts.length = 0;
  return { ...seen, stream, posts };
}

/** A number of the link in the address. @param {Page} page @param {string} name */
const inLink = (page, name) => new URLSearchParams(new URL(page.url()).hash.slice(1)).get(name);

/** @param {Page} page @param {string} name @param {(value: string | null) => boolean} wanted */
async function linked(page, name, wanted) {
  for (const start = Date.now(); Date.now() - start < 10_000; await page.waitForTimeout(50)) if (wanted(inLink(page, name))) return;
  assert.fail(`${name} in ${page.url()}`);
}

test('it loads without an error and asks no other host', async () => {
  const { page, errors, strangers, close } = await arrived('');
  await rested(page, 'standard').catch(() => rested(page, 'high'));
  assert.ok((await picture(page)).shown > 0.05);
  assert.match(await page.title(), /demo/i);
  await page.locator('.preset img[src^="blob:"]').nth(3).waitFor({ timeout: 60_000 });
  await page.getByRole('tab', { name: 'Scan' }).click();
  await page.locator('.scans img[src^="blob:"]').first().waitFor({ timeout: 60_000 });
  assert.match(await page.locator('.facts').innerText(), /160 × 192 × 192/);
  assert.deepEqual([errors, strangers], [[], []]);
  await close();
});

test('a drag turns the scan, and the picture at rest is the link’s', async () => {
  const { page, errors, close } = await arrived();
  const first = await picture(page);
  await drag(page, '#view', [0.5, 0.5], [0.7, 0.45]);
  await rested(page);
  const turned = await picture(page);
  assert.notEqual(turned.hash, first.hash);
  assert.ok(turned.shown > 0.05);
  await linked(page, 'azimuth', (azimuth) => azimuth !== null && Number(azimuth) < 20);
  const other = await arrived(new URL(page.url()).hash);
  assert.equal((await picture(other.page)).hash, turned.hash);
  assert.deepEqual([errors, other.errors], [[], []]);
  await other.close();
  await close();
});

test('a shared link shows the same pixels, whatever was set', async () => {
  const permissions = ['clipboard-read', 'clipboard-write'];
  const { page, close } = await arrived(CALM, { permissions });
  await drag(page, '#view', [0.4, 0.5], [0.6, 0.6]);
  await page.mouse.wheel(0, -200);
  await drag(page, '.transfer-plot', [0.5, 0.3], [0.55, 0.3]);
  await page.getByRole('tab', { name: 'Light' }).click();
  await page.getByRole('button', { name: 'Add a lamp' }).click();
  await page.getByRole('switch', { name: 'Shadows' }).check();
  await page.getByText('Fade with depth').click();
  await page.getByRole('tab', { name: 'View' }).click();
  await page.getByRole('radio', { name: 'Perspective' }).check();
  await rested(page);
  const mine = await picture(page);
  await page.getByRole('button', { name: 'Copy a link' }).click();
  await page.getByText('Link copied.').waitFor();
  const link = await page.evaluate(() => navigator.clipboard.readText());
  for (const name of ['azimuth', 'zoom', 'target', 'tf', 'shading', 'depth', 'projection']) assert.ok(link.includes(`${name}=`), `${name} in ${link}`);
  const other = await arrived(new URL(link).hash);
  assert.equal((await picture(other.page)).hash, mine.hash);
  await other.close();
  await close();
});

test('the transfer function can be edited, undone and done again', async () => {
  const { page, errors, close } = await arrived();
  const points = page.locator('.transfer-plot .point');
  await points.first().waitFor();
  const [count, first] = [await points.count(), await picture(page)];
  await page.locator('.transfer-plot').scrollIntoViewIfNeeded();
  const box = await page.locator('.transfer-plot').boundingBox();
  assert.ok(box);
  await page.mouse.click(box.x + box.width * 0.3, box.y + 30);
  assert.equal(await points.count(), count + 1);
  await rested(page);
  const added = await picture(page);
  assert.notEqual(added.hash, first.hash);
  await linked(page, 'tf', (tf) => tf !== null && tf.split(';').length > count);

  const selected = page.locator('.transfer-plot .point.selected');
  const before = await selected.getAttribute('aria-valuetext');
  const at = await selected.boundingBox();
  assert.ok(at);
  await page.mouse.move(at.x + at.width / 2, at.y + at.height / 2);
  await page.mouse.down();
  await page.mouse.move(at.x + at.width / 2 + 6, at.y + 90, { steps: 6 });
  await page.mouse.up();
  assert.notEqual(await selected.getAttribute('aria-valuetext'), before);
  await rested(page);
  const moved = await picture(page);
  assert.notEqual(moved.hash, added.hash);

  await page.getByRole('button', { name: 'Undo' }).click();
  await rested(page);
  assert.equal((await picture(page)).hash, added.hash);
  await page.getByRole('button', { name: 'Undo' }).click();
  await rested(page);
  assert.equal((await picture(page)).hash, first.hash);
  assert.equal(await points.count(), count);
  await page.keyboard.press('Control+Shift+z');
  await page.keyboard.press('Control+Shift+z');
  await rested(page);
  assert.equal((await picture(page)).hash, moved.hash);

  await points.nth(2).focus();
  await page.keyboard.press('ArrowUp');
  await page.keyboard.press('Delete');
  assert.equal(await points.count(), count);
  const color = page.getByLabel('Colour of the point');
  await color.fill('#00ff00');
  await linked(page, 'tf', (tf) => tf?.includes('00ff00') ?? false);
  assert.deepEqual(errors, []);
  await close();
});

test('of points close to each other the nearest one is taken', async () => {
  const { page, close } = await arrived();
  const points = page.locator('.transfer-plot .point');
  await points.nth(6).waitFor();
  await page.locator('.transfer-plot').scrollIntoViewIfNeeded();
  for (let i = 0; i < (await points.count()); i++) {
    const box = await points.nth(i).boundingBox();
    assert.ok(box);
    await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
    assert.ok(await points.nth(i).evaluate((point) => point.classList.contains('selected') && point === document.activeElement), `point ${i}`);
  }
  await close();
});

test('presets switch the look, and an edit starts from the preset', async () => {
  const { page, errors, close } = await arrived();
  const first = await picture(page);
  const bone = page.locator('.preset[data-name="ct-bone"]');
  await bone.click();
  await rested(page);
  const boneOnly = await picture(page);
  assert.notEqual(boneOnly.hash, first.hash);
  assert.equal(await bone.getAttribute('aria-pressed'), 'true');
  await linked(page, 'preset', (name) => name === 'ct-bone');
  await page.locator('.transfer-plot .point').nth(5).waitFor();
  assert.match((await page.locator('.transfer-plot .point').first().getAttribute('aria-valuetext')) ?? '', /^value 150, opacity 0, colour #8a5a3c$/);
  await page.locator('.preset[data-name="ct-skin"]').click();
  await rested(page);
  assert.notEqual((await picture(page)).hash, boneOnly.hash);
  assert.deepEqual(errors, []);
  await close();
});

test('keys turn, zoom and choose views, and reach every control', async () => {
  const { page, errors, close } = await arrived();
  const first = await picture(page);
  await page.locator('#view').focus();
  await page.keyboard.press('ArrowRight');
  await linked(page, 'azimuth', (azimuth) => azimuth !== null);
  await rested(page);
  assert.notEqual((await picture(page)).hash, first.hash);
  await page.keyboard.press('+');
  await linked(page, 'zoom', (zoom) => Number(zoom) === 1.375);
  await page.keyboard.press(']');
  await linked(page, 'roll', (roll) => roll !== null);
  await page.keyboard.press('p');
  await linked(page, 'azimuth', (azimuth) => Math.abs(Number(azimuth)) === 180);
  await linked(page, 'roll', (roll) => roll === null);
  await page.getByRole('tab', { name: 'Look' }).focus();
  await page.keyboard.press('ArrowRight');
  assert.equal(await page.getByRole('tab', { name: 'Light' }).getAttribute('aria-selected'), 'true');
  const reached = new Set();
  for (let i = 0; i < 40; i++) {
    await page.keyboard.press('Tab');
    reached.add(await page.evaluate(() => document.activeElement?.id || document.activeElement?.getAttribute('role') || document.activeElement?.getAttribute('type') || document.activeElement?.tagName));
  }
  for (const stop of ['scan-name', 'copy-link', 'view', 'switch', 'range']) assert.ok([...reached].some((name) => name === stop || (stop === 'range' && /^control-/.test(name))), `${stop} in ${[...reached]}`);
  assert.deepEqual(errors, []);
  await close();
});

test('projections, algorithms and light change the picture', async () => {
  const { page, errors, close } = await arrived();
  let before = (await picture(page)).hash;
  const differs = async () => {
    await rested(page);
    const now = (await picture(page)).hash;
    assert.notEqual(now, before);
    before = now;
  };
  await page.getByRole('tab', { name: 'View' }).click();
  await page.getByLabel('Blend').selectOption('maximum');
  await differs();
  // Windowing, by the tool that fingers have.
  await page.locator('#tools label').nth(4).click();
  await drag(page, '#view', [0.5, 0.5], [0.3, 0.5]);
  await linked(page, 'window', (window) => window !== null);
  await differs();
  await page.getByLabel('Blend').selectOption('average');
  await differs();
  assert.ok((await picture(page)).shown > 0.05, 'averages are mostly air, and seen nevertheless');
  await page.getByLabel('Blend').selectOption('composite');
  await differs();
  await page.getByLabel('Algorithm').selectOption('classified');
  await differs();
  await page.getByRole('tab', { name: 'Light' }).click();
  await page.getByText('Shade surfaces').click();
  await differs();
  await page.getByRole('button', { name: 'White' }).click();
  await differs();
  assert.deepEqual(errors, []);
  await close();
});

test('a plane and a box cut the scan open, and a link keeps it so', async () => {
  const { page, errors, stream, close } = await connected();
  const whole = await picture(page);
  await page.getByRole('tab', { name: 'Cut' }).click();
  // Keys, and what they do live: drafts over the stream.
  const depth = page.getByRole('slider', { name: 'Depth' });
  await depth.focus();
  for (let i = 0; i < 4; i++) await page.keyboard.press('PageUp');
  await rested(page);
  const open = await picture(page);
  assert.notEqual(open.hash, whole.hash);
  const { plane: facing } = stream.sent.findLast((message) => message.request).request.clip[0];
  assert.ok(facing.normal[0] < -0.4 && facing.normal[1] > 0.8 && facing.normal[2] < -0.2, `away from the eye: ${facing.normal}`);
  assert.ok(stream.sent.some((message) => message.request?.clip && message.request.quality === 'draft'), 'drafts while it moves');
  await page.getByRole('button', { name: 'Front', exact: true }).click();
  assert.equal(await page.getByRole('button', { name: 'Front', exact: true }).getAttribute('aria-pressed'), 'true');
  const top = page.getByLabel('Top', { exact: true }).and(page.getByRole('slider'));
  await top.fill('0.3');
  await rested(page);
  const both = await picture(page);
  assert.notEqual(both.hash, open.hash);
  const { clip } = stream.sent.findLast((message) => message.request).request;
  assert.deepEqual(clip[0].plane.normal, [0, 1, 0]);
  assert.ok(clip[1].box.max[2] > clip[1].box.min[2]);
  await linked(page, 'box', (box) => box === [...clip[1].box.min, ...clip[1].box.max].join(','));
  await linked(page, 'plane', (plane) => plane === [...clip[0].plane.point, 0, 1, 0].join(','));
  const other = await arrived(new URL(page.url()).hash);
  assert.equal((await picture(other.page)).hash, both.hash);
  await other.page.getByRole('tab', { name: 'Cut' }).click();
  assert.equal(await other.page.getByRole('slider', { name: 'Depth' }).inputValue(), await depth.inputValue());
  await other.close();
  // Whatever is asked for, something is left.
  await page.getByLabel('Bottom', { exact: true }).and(page.getByRole('slider')).fill('1');
  await rested(page);
  await page.getByRole('button', { name: 'Make it whole' }).click();
  await rested(page);
  assert.equal((await picture(page)).hash, whole.hash);
  await linked(page, 'plane', (plane) => plane === null);
  assert.deepEqual(errors, []);
  await close();
});

test('what cuts is moved by handles on the picture, as long as its panel is open', async () => {
  const { page, errors, close } = await arrived(`${CALM}&azimuth=20&box=-60,-70,-80,60,70,80`);
  const dots = page.locator('.handles span');
  assert.equal(await dots.count(), 0);
  await page.getByRole('tab', { name: 'Cut' }).click();
  assert.equal(await dots.count(), 6, 'a box has six sides');
  /** Drags a handle by so many pixels. @param {number} nth @param {number} dx @param {number} dy */
  const pull = async (nth, dx, dy) => {
    const box = await dots.nth(nth).boundingBox();
    assert.ok(box);
    await page.mouse.move(box.x + 9, box.y + 9);
    await page.mouse.down();
    await page.mouse.move(box.x + 9 + dx, box.y + 9 + dy, { steps: 4 });
    await page.mouse.up();
    const now = await dots.nth(nth).boundingBox();
    return now && [now.x - box.x, now.y - box.y];
  };
  const [left, top] = [1, 5];
  const moved = await pull(top, 0, 40);
  assert.ok(moved && Math.abs(moved[0]) < 1 && Math.abs(moved[1] - 40) < 1.5, `it stays under the pointer: ${moved}`);
  await linked(page, 'box', (box) => box !== null && Number(box.split(',')[5]) < 70);
  await pull(left, -50, 0);
  await linked(page, 'box', (box) => box !== null && Number(box.split(',')[3]) < 50);
  assert.deepEqual(inLink(page, 'box')?.split(',').slice(0, 3), ['-60', '-70', '-80'], 'the other sides stay');
  await page.getByRole('button', { name: 'Left', exact: true }).click();
  assert.equal(await dots.count(), 7);
  const before = inLink(page, 'plane');
  await pull(0, -30, 0);
  await linked(page, 'plane', (plane) => plane !== null && plane !== before);
  assert.equal(inLink(page, 'azimuth'), '20', 'the scan was not turned');
  await rested(page);
  await page.getByRole('tab', { name: 'Look' }).click();
  assert.equal(await dots.count(), 0);
  assert.deepEqual(errors, []);
  await close();
});

test('a lens shows what is inside, and follows pointer and keys', async () => {
  const { page, errors, stream, close } = await connected();
  const without = await picture(page);
  await page.getByRole('tab', { name: 'Cut' }).click();
  await page.getByRole('switch', { name: 'A lens in the scan' }).click();
  await rested(page);
  const first = await picture(page);
  assert.notEqual(first.hash, without.hash);
  const asked = () => stream.sent.findLast((message) => message.request).request.regions;
  const [{ sphere, opacity }] = asked();
  assert.ok(opacity < 1);
  // By the handle in its middle: in the picture's plane, in drafts while it moves, and the scan is not turned.
  const dot = await page.locator('.handles span').boundingBox();
  assert.ok(dot);
  stream.sent.length = 0;
  await page.mouse.move(dot.x + 9, dot.y + 9);
  await page.mouse.down();
  await page.mouse.move(dot.x + 59, dot.y - 21, { steps: 5 });
  await page.mouse.up();
  const now = await page.locator('.handles span').boundingBox();
  assert.ok(now && Math.abs(now.x - dot.x - 50) < 1.5 && Math.abs(now.y - dot.y + 30) < 1.5, `under the pointer: ${JSON.stringify(now)}`);
  await rested(page);
  assert.ok(stream.sent.some((message) => message.request?.regions && message.request.quality === 'draft'), 'drafts while it moves');
  const moved = asked()[0].sphere;
  assert.equal(moved.radius, sphere.radius);
  assert.notDeepEqual(moved.center, sphere.center);
  assert.equal(inLink(page, 'azimuth'), null, 'the scan was not turned');
  // By keys.
  const below = page.getByRole('slider', { name: 'From below' });
  await below.focus();
  await page.keyboard.press('PageUp');
  await rested(page);
  const raised = asked()[0].sphere.center;
  assert.ok(raised[2] > moved.center[2] && Math.abs(raised[0] - moved.center[0]) < 1e-9);
  // What it shows, also by another's link.
  await page.getByLabel('Shows').selectOption({ label: 'The brightest values' });
  await rested(page);
  const brightest = await picture(page);
  assert.deepEqual(asked()[0].blend, 'maximum');
  await linked(page, 'lens', (lens) => lens === `${[...raised, moved.radius].join(',')};brightest`);
  const other = await arrived(new URL(page.url()).hash);
  assert.equal((await picture(other.page)).hash, brightest.hash);
  await other.close();
  const preset = page.getByLabel('Shows').locator('option').nth(2);
  await page.getByLabel('Shows').selectOption({ index: 2 });
  await rested(page);
  assert.ok(asked()[0].transfer_function, await preset.textContent() ?? '');
  await page.getByRole('switch', { name: 'A lens in the scan' }).click();
  await rested(page);
  assert.equal((await picture(page)).hash, without.hash);
  assert.deepEqual(errors, []);
  await close();
});

test('the lists are those of the service', async () => {
  const { page, close } = await arrived();
  const contract = await (await fetch(`${service.address}/openapi.yaml`)).text();
  const listed = (/** @type {RegExp} */ pattern) => contract.match(pattern)?.[1].split(', ');
  const offered = (/** @type {string} */ label) => page.getByLabel(label).locator('option').evaluateAll((options) => options.map((option) => /** @type {HTMLOptionElement} */ (option).value));
  await page.getByRole('tab', { name: 'View' }).click();
  assert.deepEqual((await offered('Algorithm')).sort(), listed(/\n {4}Algorithm:[^]*?enum: \[([^\]]*)\]/)?.sort());
  assert.deepEqual(await offered('Blend'), listed(/\n {4}Blend:[^]*?enum: \[([^\]]*)\]/));
  await close();
});

test('on a slow line without a stream the newest view wins and the last picture moves along', async () => {
  const release = await narrow.hold();
  const { page, close } = await arrived(CALM, {}, narrow);
  let [most, all] = [0, 0];
  // Where a machine is slow the view rests between two moves, and more than drafts is asked for.
  const drafts = new Set();
  page.on('request', (request) => {
    if (!request.url().endsWith('/frame')) return;
    if (request.postDataJSON().quality === 'draft') most = Math.max(most, drafts.add(request).size);
    all++;
  });
  for (const end of /** @type {const} */ (['requestfinished', 'requestfailed'])) page.on(/** @type {any} */ (end), (request) => drafts.delete(request));
  await page.route(FRAMES, async (route) => {
    await new Promise((resolve) => setTimeout(resolve, 300));
    await route.continue().catch(() => {});
  });
  const first = await picture(page);
  const box = await page.locator('#view').boundingBox();
  assert.ok(box);
  await page.mouse.move(box.x + 200, box.y + 200);
  await page.mouse.down({ button: 'middle' });
  for (let i = 1; i <= 30; i++) await page.mouse.move(box.x + 200 + 4 * i, box.y + 200);
  // Panned at once, though no frame can have come.
  assert.notEqual((await picture(page)).hash, first.hash);
  for (let i = 30; i <= 60; i++) await page.mouse.move(box.x + 200 + 4 * i, box.y + 200);
  await page.mouse.up({ button: 'middle' });
  await rested(page);
  assert.ok(most <= 2, `${most} drafts were under way at once`);
  assert.ok(most > 0 && all < 30, `${all} frames for 60 moves`);
  const last = await picture(page);
  await page.unroute(FRAMES);
  await linked(page, 'target', (target) => target !== null);
  const other = await arrived(new URL(page.url()).hash);
  assert.equal((await picture(other.page)).hash, last.hash);
  await other.close();
  await close();
  release();
});

test('frames come over the stream, byte for byte those of the route', async () => {
  const { page, errors, strangers, stream, posts, close } = await connected();
  const first = await picture(page);
  await drag(page, '#view', [0.5, 0.5], [0.7, 0.45]);
  await rested(page);
  assert.equal(posts.length, 0, 'nothing is asked for beside it');
  const asked = stream.sent.filter(({ request }) => request);
  const newest = stream.frames[stream.frames.length - 1];
  assert.deepEqual([asked[0].moving, asked[0].request.quality], ['draft', 'draft']);
  assert.deepEqual([newest.header.request, newest.header.quality], [asked.length, 'standard']);
  const numbers = stream.frames.map(({ header }) => header.sequence);
  await until(page, () => numbers.every((number) => stream.sent.some(({ ack }) => ack === number)));
  const response = await fetch(`${service.address}/v1/volumes/demo/frame`, {
    method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify(asked[asked.length - 1].request),
  });
  assert.ok(Buffer.from(await response.arrayBuffer()).equals(newest.picture));
  const turned = await picture(page);
  assert.notEqual(turned.hash, first.hash);
  // A first picture comes over HTTP.
  await linked(page, 'azimuth', (azimuth) => azimuth !== null);
  const other = await arrived(new URL(page.url()).hash);
  assert.equal((await picture(other.page)).hash, turned.hash);
  assert.deepEqual([errors, strangers.filter((url) => !url.startsWith(service.address))], [[], []]);
  await other.close();
  await close();
});

test('on a slow line two frames of the stream are on their way at most', async () => {
  const { page, close } = await visit(browser, 'about:blank');
  let [under, most, all] = [0, 0, 0];
  await page.routeWebSocket(/stream$/, (socket) => {
    const server = socket.connectToServer();
    socket.onMessage((message) => {
      if (JSON.parse(String(message)).moving === 'draft') most = Math.max(most, ++under);
      server.send(message);
    });
    server.onMessage((message) => setTimeout(() => {
      all++;
      if (String(message).includes('"quality":"draft"')) under--;
      socket.send(message);
    }, 300));
  });
  await page.goto(`${service.address}/${CALM}`);
  await rested(page);
  await page.waitForTimeout(500);
  const first = await picture(page);
  const box = await page.locator('#view').boundingBox();
  assert.ok(box);
  await page.mouse.move(box.x + 200, box.y + 200);
  await page.mouse.down({ button: 'middle' });
  for (let i = 1; i <= 60; i++) await page.mouse.move(box.x + 200 + 4 * i, box.y + 200);
  assert.notEqual((await picture(page)).hash, first.hash, 'panned at once');
  await page.mouse.up({ button: 'middle' });
  await rested(page);
  const last = await picture(page);
  assert.ok(most > 0 && most <= 2, `${most} drafts were under way at once`);
  assert.ok(all < 30, `${all} frames for 60 moves`);
  await linked(page, 'target', (target) => target !== null);
  const other = await arrived(new URL(page.url()).hash);
  assert.equal((await picture(other.page)).hash, last.hash);
  await other.close();
  await close();
});

test('where no stream is to be had frames come over HTTP, and over one when there is', async () => {
  const release = await narrow.hold();
  const { page, stream, posts, errors, close } = await connected(narrow);
  const first = await picture(page);
  await drag(page, '#view', [0.5, 0.5], [0.7, 0.45]);
  await rested(page);
  const turned = await picture(page);
  assert.notEqual(turned.hash, first.hash);
  assert.ok(posts.length > 1 && stream.frames.length === 0);
  assert.equal(await page.locator('.message').count(), 0);
  release();
  await until(page, async () => {
    await page.locator('#view').press('[');
    return stream.frames.length > 0;
  });
  // What the browser itself says about refused handshakes, and nothing else.
  assert.deepEqual(errors.filter((error) => !error.includes('503')), []);
  await close();
});

test('a page that nobody sees asks for nothing', async () => {
  const { page, stream, posts, errors, close } = await connected();
  const first = await picture(page);
  const show = (/** @type {boolean} */ shown) => page.evaluate((hidden) => {
    Object.defineProperty(document, 'hidden', { value: hidden, configurable: true });
    document.dispatchEvent(new Event('visibilitychange'));
  }, !shown);
  await show(false);
  await until(page, () => stream.ended === 1);
  await page.locator('#view').focus();
  await page.keyboard.press('ArrowRight');
  await page.waitForTimeout(500);
  assert.deepEqual([posts.length, stream.sent.length, stream.opened], [0, 0, 1]);
  await show(true);
  await rested(page);
  assert.notEqual((await picture(page)).hash, first.hash);
  await until(page, () => stream.opened === 2);
  assert.deepEqual(errors, []);
  await close();
});

test('a busy service is named, and asked again when it said', async () => {
  const release = await narrow.hold();
  const { page, errors, close } = await arrived(CALM, {}, narrow);
  let refusals = 0;
  await page.route(FRAMES, (route) => {
    if (++refusals > 2) return route.continue();
    const body = { type: 'urn:shearwarp:problem:busy', title: 'Too busy', status: 503, detail: 'the queue is full' };
    return route.fulfill({ status: 503, headers: { 'Retry-After': '1' }, contentType: 'application/problem+json', body: JSON.stringify(body) });
  });
  const before = await picture(page);
  await page.locator('.preset[data-name="ct-bone"]').click();
  await page.getByText('The service is busy').waitFor();
  assert.match(await page.locator('#messages').innerText(), /Trying again in 1 s/);
  assert.equal((await picture(page)).hash, before.hash, 'the last picture stays');
  await rested(page);
  assert.notEqual((await picture(page)).hash, before.hash);
  assert.equal(await page.locator('.message').count(), 0);
  // What the browser itself says about refusals, and nothing else.
  assert.deepEqual(errors.filter((error) => !error.includes('503')), []);
  await close();
  release();
});

test('a full queue is survived', async (t) => {
  const small = await Service.start('127.0.0.1:0', { SHEARWARP_RENDER__QUEUE: '1', SHEARWARP_RENDER__JOBS: '1', SHEARWARP_STREAM__MAX_STREAMS: '1' });
  const abort = new AbortController();
  t.after(() => small.stop());
  t.after(() => abort.abort());
  await small.hold();
  const seen = await arrived(CALM, {}, small);
  // The page itself asks for nothing more.
  await until(seen.page, () => seen.page.locator('.preset img').evaluateAll((images) => images.every((image) => !image.checkVisibility() || /^blob:/.test(image.getAttribute('src') ?? ''))));
  // Slow frames of others take the one job and the one place in the queue.
  const slow = { algorithm: 'raycast', sample_distance: 0.01, early_ray_termination: 1, image: { width: 2048, height: 2048 } };
  const others = Array.from({ length: 2 }, () => fetch(`${small.address}/v1/volumes/demo/frame`, {
    method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify(slow), signal: abort.signal,
  }).catch(() => null));
  await until(seen.page, async () => (await small.waiting()) === 1);
  await seen.page.locator('.preset[data-name="ct-bone"]').click();
  await seen.page.getByText('The service is busy').waitFor();
  abort.abort();
  await Promise.all(others);
  await rested(seen.page);
  assert.equal(await seen.page.locator('.message').count(), 0);
  await seen.close();
});

test('a restart of the service is survived', async (t) => {
  const mortal = await Service.start();
  t.after(() => mortal.stop());
  const seen = await connected(mortal);
  await drag(seen.page, '#view', [0.5, 0.5], [0.55, 0.5]);
  await rested(seen.page);
  assert.ok(seen.stream.frames.length > 0);
  const before = await picture(seen.page);
  await mortal.stop();
  await drag(seen.page, '#view', [0.5, 0.5], [0.6, 0.5]);
  await seen.page.getByText('The service does not answer').waitFor();
  assert.ok((await picture(seen.page)).shown > 0.05, 'the last picture stays');
  const icon = await seen.page.locator('.message .icon use').boundingBox();
  assert.ok(icon && icon.width > 5, 'icons need no service');
  const risen = await Service.start(new URL(mortal.address).host);
  t.after(() => risen.stop());
  await seen.page.getByRole('button', { name: 'Try now' }).click({ timeout: 3000 }).catch(() => {});
  await rested(seen.page);
  assert.notEqual((await picture(seen.page)).hash, before.hash);
  assert.equal(await seen.page.locator('.message').count(), 0);
  // Once more over a stream, when the time for it has come.
  const { length } = seen.stream.frames;
  await until(seen.page, async () => {
    await seen.page.locator('#view').press('[');
    return seen.stream.frames.length > length;
  });
  await seen.close();
});

test('a refusal names the field', async () => {
  const { page, close } = await visit(browser, `${service.address}/${CALM}&projection=perspective&fov_y=500`);
  const message = page.locator('.message.refused');
  await message.waitFor();
  assert.match(await message.innerText(), /The service refuses this[^]*\/camera\/fov_y/);
  await page.getByRole('tab', { name: 'View' }).click();
  await page.getByRole('radio', { name: 'Parallel' }).check();
  await rested(page);
  assert.equal(await message.count(), 0);
  // The same over the stream, which goes on.
  await linked(page, 'projection', (projection) => projection === null);
  const stream = streams(page);
  await page.reload();
  await rested(page);
  await until(page, () => stream.opened > 0);
  await page.waitForTimeout(200);
  await page.evaluate(() => (location.hash += '&projection=perspective&fov_y=500'));
  await message.waitFor();
  assert.match(await message.innerText(), /\/camera\/fov_y/);
  assert.ok(stream.sent.some(({ request }) => request?.camera.fov_y === 500));
  await page.getByRole('tab', { name: 'View' }).click();
  await page.getByRole('radio', { name: 'Parallel' }).check();
  await rested(page);
  assert.ok(stream.frames.length > 0 && stream.ended === 0);
  await close();
});

test('a link to a scan that is not there shows those that are', async () => {
  const { page, close } = await visit(browser, `${service.address}/#volume=nothing&quality=standard`);
  await page.locator('.message.missing').waitFor();
  assert.match(await page.locator('.message').innerText(), /There is no scan “nothing”/);
  assert.equal(await page.getByText('The service answers again.').count(), 0);
  await page.locator('.scans button').first().click();
  await rested(page);
  assert.equal(await page.locator('.message').count(), 0);
  await close();
});

test('the wheel scrolls the panel, and with Ctrl it enlarges the axis', async () => {
  const { page, close } = await arrived(CALM, { viewport: { width: 1000, height: 500 } });
  const point = page.locator('.transfer-plot .point').nth(5);
  await point.waitFor();
  await page.locator('.transfer-plot').scrollIntoViewIfNeeded();
  await page.locator('.transfer-plot').hover();
  const [top, place] = [await page.locator('#panels').evaluate((panels) => panels.scrollTop), await point.getAttribute('transform')];
  await page.mouse.wheel(0, 100);
  await page.waitForFunction((before) => (document.querySelector('#panels')?.scrollTop ?? 0) > before, top);
  assert.equal(await point.getAttribute('transform'), place);
  await page.locator('.transfer-plot').hover();
  await page.keyboard.down('Control');
  await page.mouse.wheel(0, -100);
  await page.keyboard.up('Control');
  await page.waitForFunction((before) => document.querySelectorAll('.transfer-plot .point')[5].getAttribute('transform') !== before, place);
  await close();
});

test('a picture is saved at the size that was asked for, and as the command says', async () => {
  const folder = mkdtempSync(join(tmpdir(), 'viewer-'));
  const { page, close } = await arrived(CALM, { permissions: ['clipboard-read', 'clipboard-write'] });
  const size = (/** @type {string} */ path) => [16, 20].map((at) => readFileSync(path).readUInt32BE(at));
  await page.getByRole('button', { name: 'Save a picture' }).click();
  await page.getByLabel('Width').last().fill('321');
  await page.getByLabel('Height').last().fill('234');
  await page.getByLabel('Height').last().blur();
  const downloading = page.waitForEvent('download');
  await page.getByRole('button', { name: 'Save', exact: true }).click();
  const download = await downloading;
  assert.equal(download.suggestedFilename(), 'demo.png');
  await download.saveAs(join(folder, 'saved.png'));
  assert.deepEqual(size(join(folder, 'saved.png')), [321, 234]);

  await page.getByRole('button', { name: 'Copy as a curl command' }).click();
  await page.getByText('Command copied.').waitFor();
  const command = await page.evaluate(() => navigator.clipboard.readText());
  await promisify(execFile)('sh', ['-c', command.replace(/^curl/, 'curl -sf')], { cwd: folder });
  const shown = await page.locator('#view').boundingBox();
  assert.deepEqual(size(join(folder, 'frame.png')), [shown?.width, shown?.height]);
  await page.getByRole('tab', { name: 'View' }).click();
  await page.getByRole('radio', { name: 'High' }).check();
  await page.getByRole('button', { name: 'Copy as a curl command' }).click();
  await page.waitForFunction(async () => (await navigator.clipboard.readText()).includes('"quality":"high"'));
  rmSync(folder, { recursive: true });
  await close();
});

test('a turntable is saved as an animated picture, and can be given up', async () => {
  const folder = mkdtempSync(join(tmpdir(), 'viewer-'));
  const { page, errors, close } = await arrived();
  const ask = async (/** @type {string} */ frames) => {
    await page.getByRole('button', { name: 'Save a picture' }).click();
    await page.getByRole('radio', { name: 'Turntable' }).check();
    for (const [label, value] of [['Width', '96'], ['Height', '64'], ['Frames', frames]]) await page.getByLabel(label, { exact: true }).last().fill(value);
    await page.getByRole('button', { name: 'Save', exact: true }).click();
  };
  await ask('700');
  await page.getByRole('progressbar').waitFor();
  await page.getByRole('button', { name: 'Cancel' }).click();
  const downloading = page.waitForEvent('download');
  await ask('5');
  const download = await downloading;
  assert.equal(download.suggestedFilename(), 'demo-turntable.png');
  await download.saveAs(join(folder, 'turn.png'));
  await page.getByText('Turntable saved.').waitFor();
  const seen = await page.evaluate(async (base64) => {
    const data = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
    const decoder = new ImageDecoder({ data, type: 'image/png' });
    await decoder.tracks.ready;
    const pictures = [];
    for (let frameIndex = 0; frameIndex < (decoder.tracks.selectedTrack?.frameCount ?? 0); frameIndex++) {
      const { image } = await decoder.decode({ frameIndex });
      const pixels = new Uint8Array(image.allocationSize({ format: 'RGBA' }));
      await image.copyTo(pixels, { format: 'RGBA' });
      pictures.push({ size: [image.displayWidth, image.displayHeight], ms: (image.duration ?? 0) / 1000, sum: pixels.reduce((sum, value, i) => (sum * 31 + value * (i % 7)) % 1e9, 0) });
    }
    return pictures;
  }, readFileSync(join(folder, 'turn.png')).toString('base64'));
  assert.deepEqual(seen.map(({ size, ms }) => [...size, ms]), Array(5).fill([96, 64, 1200]));
  assert.equal(new Set(seen.map(({ sum }) => sum)).size, 5, 'each frame is another view');
  rmSync(folder, { recursive: true });
  assert.deepEqual(errors, []);
  await close();
});

test('a phone held upright has room for everything, and fingers turn and enlarge', async () => {
  const { page, errors, close } = await arrived(CALM, { viewport: { width: 360, height: 740 }, hasTouch: true, isMobile: true });
  for (const name of ['Scan', 'Look', 'Light', 'Cut', 'View']) {
    await page.getByRole('tab', { name }).click();
    const { inner, outer } = await page.evaluate(() => ({ inner: document.documentElement.scrollWidth, outer: innerWidth }));
    assert.ok(inner <= outer && outer === 360, `${name}: ${inner} in ${outer}`);
    const cut = await page.locator('#panels').evaluate((panels) => panels.scrollWidth > panels.clientWidth);
    assert.equal(cut, false, name);
  }
  const before = await picture(page);
  const client = await page.context().newCDPSession(page);
  const touch = (/** @type {string} */ type, /** @type {number[][]} */ ...at) =>
    client.send('Input.dispatchTouchEvent', { type: /** @type {any} */ (type), touchPoints: at.map(([x, y], id) => ({ x, y, id })) });
  await touch('touchStart', [150, 250]);
  for (let i = 1; i <= 8; i++) await touch('touchMove', [150 + 5 * i, 250]);
  await touch('touchEnd');
  await linked(page, 'azimuth', (azimuth) => azimuth !== null);
  await touch('touchStart', [150, 250], [210, 250]);
  for (let i = 1; i <= 8; i++) await touch('touchMove', [150 - 3 * i, 250], [210 + 3 * i, 250]);
  await touch('touchEnd');
  await linked(page, 'zoom', (zoom) => Number(zoom) > 1.8);
  await rested(page);
  assert.notEqual((await picture(page)).hash, before.hash);
  assert.deepEqual(errors, []);
  await close();
});

test('nothing that assistive technology needs is missing, in light and in dark', async () => {
  const axe = readFileSync(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8');
  for (const colorScheme of /** @type {const} */ (['light', 'dark'])) {
    const { page, close } = await arrived(CALM, { colorScheme, reducedMotion: 'reduce' });
    await page.locator('.transfer-plot .point').first().waitFor();
    for (const name of ['Scan', 'Look', 'Light', 'Cut', 'View']) {
      await page.getByRole('tab', { name }).click();
      await page.evaluate(axe);
      const found = await page.evaluate(async () => {
        // @ts-expect-error: axe is what was just evaluated
        const { violations } = await axe.run(document, { runOnly: ['wcag2a', 'wcag2aa', 'wcag21aa', 'wcag22aa'] });
        return violations.map((/** @type {any} */ { id, nodes }) => `${id}: ${nodes.map((/** @type {any} */ node) => node.html).join(' ')}`);
      });
      assert.deepEqual(found, [], `${name}, ${colorScheme}`);
    }
    await close();
  }
});

test('the theme is the system’s until one is chosen, and is kept', async () => {
  const { page, close } = await arrived(CALM, { colorScheme: 'dark' });
  const ground = () => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  const dark = await ground();
  await page.getByRole('button', { name: 'Theme' }).click();
  const light = await ground();
  assert.notEqual(light, dark);
  await page.reload();
  assert.equal(await ground(), light);
  await close();
});
