/** @file The modules that need no page: what they promise, by plain numbers. */
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { readTimings } from '../../web/js/api.js';
import { ANATOMICAL, angles, axes, between, boundingSphere, extent, orbited, panned, spun, swivelled, zoomed } from '../../web/js/camera.js';
import { fromHash, toHash } from '../../web/js/link.js';
import { looksFor } from '../../web/js/looks.js';
import { curlCommand, renderRequest, tidy } from '../../web/js/request.js';
import { DEFAULTS, DEFAULT_CAMERA, DEFAULT_SHADING } from '../../web/js/state.js';
import { heightOf, opacityOf, sampled, short, ticks, windowOf, windowed, withChanged, withPoint } from '../../web/js/transfer.js';
import { add, dot, scale, subtract } from '../../web/js/vector.js';
import { carried, matrix3d, placed } from '../../web/js/warp.js';

/** @typedef {import('../../web/js/state.js').Camera} Camera */
/** @typedef {import('../../web/js/state.js').State} State */
/** @typedef {import('../../web/js/vector.js').Vector} Vector */

/** @type {import('../../web/js/camera.js').Sphere} */
const SPHERE = { centre: [10, -20, 30], radius: 100 };
const ORIENTATIONS = [-180, -121, -30, 0, 45, 90, 179].flatMap((azimuth) =>
  [-90, -60, 0, 15, 89.9, 90].flatMap((elevation) => [-170, 0, 33].map((roll) => ({ ...DEFAULT_CAMERA, azimuth, elevation, roll }))));

/** @param {Vector} a @param {Vector} b @param {string} [what] */
const near = (a, b, what) => a.forEach((value, i) => assert.ok(Math.abs(value - b[i]) < 1e-6, `${what}: ${a} and ${b}`));

/** Where a point lies in a camera's picture, the shorter side being -1..1, y down. @param {Camera} camera @param {Vector} point @returns {Vector} */
function projected(camera, point) {
  const { right, up } = axes(camera);
  const offset = add(point, scale(camera.target ?? SPHERE.centre, -1));
  const mm = extent(camera, SPHERE) / 2;
  return [dot(offset, right) / mm, -dot(offset, up) / mm, 0];
}

test('angles are read back from axes, at the poles too', () => {
  for (const camera of ORIENTATIONS) {
    const [before, after] = [axes(camera), axes(angles(axes(camera)))];
    for (const name of /** @type {const} */ (['right', 'up', 'back'])) near(after[name], before[name], `${name} of ${JSON.stringify(camera)}`);
  }
});

test('anatomical views look along the patient’s axes', () => {
  /** @type {Record<string, Vector>} */
  const towards = { A: [0, -1, 0], P: [0, 1, 0], L: [1, 0, 0], R: [-1, 0, 0], S: [0, 0, 1], I: [0, 0, -1] };
  for (const [name, view] of Object.entries(ANATOMICAL)) near(axes({ ...view, roll: 0 }).back, towards[name], name);
});

test('what is under the pointer follows it', () => {
  const camera = { ...DEFAULT_CAMERA, azimuth: 20, elevation: 10 };
  // A point in front of the centre, dragged to the right and up, is seen further to the right and higher.
  const front = add(SPHERE.centre, scale(axes(camera).back, 50));
  const dragged = { ...camera, ...orbited(camera, [0, 0], [0.1, 0.05]) };
  const [x, y] = projected(dragged, front);
  assert.ok(x > 0.01 && y < -0.005, `${x} ${y}`);
  const [sx, sy] = projected({ ...camera, ...swivelled(camera, 0.1, 0.05) }, front);
  assert.ok(sx > 0.01 && sy < -0.005, `${sx} ${sy}`);
  const rolled = { ...camera, ...spun(camera, [0, 0, 1], 0.1) };
  const right = add(SPHERE.centre, scale(axes(camera).right, 50));
  assert.ok(projected(rolled, right)[1] < projected(camera, right)[1], 'counter-clockwise is up on the right');
  near(axes(rolled).back, axes(camera).back, 'a roll keeps the direction');
  near(projected({ ...camera, ...panned(camera, SPHERE, 0.2, 0.1) }, SPHERE.centre), [0.2, -0.1, 0], 'pan');
});

test('a zoom keeps the point under the pointer where it is', () => {
  const camera = { ...DEFAULT_CAMERA, azimuth: 50, roll: 12 };
  const { right, up } = axes(camera);
  const mm = extent(camera, SPHERE) / 2;
  const point = add(SPHERE.centre, add(scale(right, 0.4 * mm), scale(up, -0.3 * mm)));
  near(projected({ ...camera, ...zoomed(camera, SPHERE, 1.7, [0.4, -0.3]) }, point), [0.4, 0.3, 0], 'zoom');
});

/** @param {number[]} h @param {number[]} point @returns {Vector} */
const through = ([a, b, c, d, e, f, g, h, i], [x, y]) => [(a * x + b * y + c) / (g * x + h * y + i), (d * x + e * y + f) / (g * x + h * y + i), 0];

/** Where a camera sees a point, as `carried` counts. @param {Camera} camera @param {Vector} point @returns {Vector} */
function seen(camera, point) {
  const [x, y] = projected(camera, point);
  const { back } = axes(camera);
  const distance = SPHERE.radius / Math.sin((camera.fov_y * Math.PI) / 360);
  const depth = dot(back, subtract(point, camera.target ?? SPHERE.centre));
  const nearer = camera.projection === 'parallel' ? 1 : distance / (distance - depth);
  return [x * nearer, y * nearer, 0];
}

test('a frame is carried to where its scan now is', () => {
  const from = { ...DEFAULT_CAMERA, azimuth: 20, elevation: -10 };
  const panned_ = { ...from, ...panned(from, SPHERE, 0.3, -0.2) };
  const rolled = { ...panned_, ...spun(panned_, [0, 0, 1], 0.4) };
  const to = { ...rolled, ...zoomed(rolled, SPHERE, 1.5, [0.1, 0.2]) };
  // In parallel projection pans, rolls and zooms are exact at any depth.
  for (const depth of [-40, 0, 70]) {
    const point = add(add(SPHERE.centre, scale(axes(from).back, depth)), scale(axes(from).right, 25));
    near(through(carried(from, to, SPHERE), projected(from, point)), projected(to, point), `depth ${depth}`);
  }
});

test('points of the plane that a camera faced go where another one sees them', () => {
  const from = /** @type {Camera} */ ({ ...DEFAULT_CAMERA, azimuth: 20, elevation: -10, target: [12, -3, 40], fov_y: 50 });
  const { right, up } = axes(from);
  for (const projection of /** @type {const} */ (['parallel', 'perspective'])) {
    const old = { ...from, projection };
    const turned = { ...old, azimuth: 55, elevation: 30, roll: 12, zoom: 2, target: /** @type {Vector} */ ([5, 5, 5]) };
    for (const to of [old, { ...old }, turned, /** @type {Camera} */ ({ ...turned, projection: 'perspective', fov_y: 80 })]) {
      for (const [across, upwards] of [[0, 0], [30, -10], [-22, 41]]) {
        const point = add(from.target ?? SPHERE.centre, add(scale(right, across), scale(up, upwards)));
        near(through(carried(old, to, SPHERE), seen(old, point)), seen(to, point), `${projection} to ${JSON.stringify(to)}`);
      }
    }
  }
});

test('a frame lies on the view as its size, its warp and the camera say', () => {
  const [camera, size] = [DEFAULT_CAMERA, { width: 400, height: 300 }];
  const frame = { size, state: { camera } };
  const at = (/** @type {Camera} */ now, /** @type {number[]} */ point, view = size, warp = /** @type {number[] | undefined} */ (undefined)) =>
    through(placed({ ...frame, warp }, now, SPHERE, view), point);
  near(at(camera, [10, 20]), [10, 20, 0], 'as it is');
  // 0.5 of half the shorter side is 75 pixels.
  near(at({ ...camera, ...panned(camera, SPHERE, 0.5, 0.1) }, [10, 20]), [85, 5, 0], 'moved');
  near(at({ ...camera, zoom: 2 * camera.zoom }, [210, 130]), [220, 110, 0], 'enlarged about the middle');
  near(at(camera, [10, 20], { width: 800, height: 600 }), [20, 40, 0], 'on a finer screen');
  near(at(camera, [10, 20], { width: 500, height: 300 }), [60, 20, 0], 'on a wider one');
  near(at(camera, [10, 20], size, [2, 0, 7, 0, 3, 9, 0, 0, 1]), [27, 69, 0], 'unwarped');
  assert.equal(matrix3d([1, 2, 3, 4, 5, 6, 7, 8, 9]), 'matrix3d(1,4,0,7,2,5,0,8,0,0,1,0,3,6,0,9)');
});

test('a turn to another view starts here and ends there', () => {
  for (const camera of ORIENTATIONS) {
    const to = { azimuth: 90, elevation: 0, roll: 0 };
    near(axes(between(camera, to, 0)).back, axes(camera).back, 'start');
    const end = axes(between(camera, to, 1));
    near(end.back, axes(to).back, `end of ${JSON.stringify(camera)}`);
    near(end.up, axes(to).up, `end of ${JSON.stringify(camera)}`);
  }
});

test('the bounding sphere is that of the voxel centres', () => {
  const volume = { dimensions: [3, 5, 9], spacing: [1, 2, 0.5], origin: [100, 0, 0], direction: [0, -1, 0, 1, 0, 0, 0, 0, 1] };
  const { centre, radius } = boundingSphere(volume);
  near(centre, [100 - 4, 1, 2], 'centre');
  assert.equal(radius, Math.hypot(1, 4, 2));
});

/** @type {State} */
const RICH = {
  volume: 'a b&ü', camera: { projection: 'perspective', azimuth: -12.34, elevation: 5.6, roll: 7, zoom: 2.5, fov_y: 45, target: [1.5, -2, 3.25] },
  transfer: { points: [{ value: -1000, opacity: 0, color: '#000000' }, { value: 1e-7, opacity: 0.25, color: '#ff8800' }], opacity_distance: 0.5, gradient_opacity: [{ value: 10, opacity: 0 }, { value: 50, opacity: 1 }] },
  shading: { ...DEFAULT_SHADING, ambient: 0.3, lights: ['headlight', { direction: [0.5, -0.25, 0.125], intensity: 0.8 }, { direction: [1, 0, 0], intensity: 1, shadows: true }] },
  blend: 'average', window: { center: 40, width: 400 }, depthCueing: { front: 1.2, density: 0.5 },
  plane: { point: [1, -2.5, 0], normal: [0, 0.6, -0.8] }, box: { min: [-1, -2, -3], max: [1, 2, 3.5] },
  lens: { center: [1, -2, 0.5], radius: 12.5, shows: 'fainter' },
  background: '#20242b', algorithm: 'raycast', quality: 'high',
};

test('a link holds the whole state, and only what differs from the defaults', () => {
  assert.deepEqual(fromHash(toHash(RICH)), RICH);
  const other = { ...RICH, transfer: 'ct-bone', shading: false, background: 'transparent', lens: RICH.lens && { ...RICH.lens, shows: /** @type {import('../../web/js/state.js').TransferFunction} */ (RICH.transfer) } };
  assert.deepEqual(fromHash(toHash(other)), other);
  assert.equal(toHash({ ...DEFAULTS, volume: 'head' }), '#volume=head');
  assert.deepEqual(fromHash('#volume=head'), { ...DEFAULTS, volume: 'head' });
});

test('half a link still shows the scan', () => {
  for (const broken of ['zoom=', 'azimuth=x', 'target=1,2', 'tf=1:2', 'tf=;;:', 'shading=maybe', 'shading=1,2,3', 'window=,', 'blend=none', 'background=red', 'plane=1,2,3', 'plane=1,2,3,0,0,0', 'box=0,0,0,1,1,0', 'lens=1,2,3,4', 'lens=1,2,3,0;fainter', 'lens=1,2;x', 'quality=best', 'depth=1', '%E0%A4'])
    assert.deepEqual(fromHash(`#volume=head&${broken}`), { ...DEFAULTS, volume: 'head' }, broken);
});

test('a request and its link have the same numbers', () => {
  const camera = { ...DEFAULT_CAMERA, azimuth: 370.123456, elevation: 1 / 3, zoom: Math.PI, target: /** @type {Vector} */ ([1 / 3, 2 / 3, 1]) };
  const state = { ...DEFAULTS, volume: 'head', camera };
  const size = { width: 640, height: 480 };
  assert.deepEqual(renderRequest(fromHash(toHash(state)), size, 'standard'), renderRequest(state, size, 'standard'));
  assert.equal(tidy(camera).azimuth, 10.12);
});

test('a zoom is about the shorter side of the picture', () => {
  const zoom = (/** @type {number} */ width, /** @type {number} */ height) => renderRequest(DEFAULTS, { width, height }, 'draft').camera.zoom;
  assert.equal(zoom(800, 400), DEFAULT_CAMERA.zoom);
  assert.equal(zoom(400, 800), DEFAULT_CAMERA.zoom / 2);
});

test('a projection asks for nothing that it does not look at', () => {
  const request = renderRequest({ ...RICH, blend: 'maximum' }, { width: 8, height: 8 }, 'draft');
  assert.deepEqual(Object.keys(request).sort(), ['algorithm', 'blend', 'camera', 'clip', 'image', 'quality', 'window']);
});

test('a lens is asked for where there can be one', () => {
  const regions = (/** @type {Partial<State>} */ patch) => renderRequest({ ...RICH, blend: 'composite', ...patch }, { width: 8, height: 8 }, 'draft').regions;
  const sphere = { center: [1, -2, 0.5], radius: 12.5 };
  const lens = /** @type {import('../../web/js/state.js').Lens} */ (RICH.lens);
  assert.deepEqual(regions({}), [{ sphere, opacity: 0.15 }]);
  assert.deepEqual(regions({ lens: { ...lens, shows: 'ct-bone' } }), [{ sphere, transfer_function: 'ct-bone' }]);
  const brightest = { ...lens, shows: 'brightest' };
  assert.deepEqual(regions({ lens: brightest }), [{ sphere, blend: 'maximum' }]);
  for (const algorithm of /** @type {const} */ (['classified', 'fast-classification'])) assert.equal(regions({ lens: brightest, algorithm }), undefined);
  assert.equal(regions({ blend: 'minimum' }), undefined);
  assert.equal(regions({ lens: null }), undefined);
});

test('a curl command survives quotes', () => {
  const command = curlCommand({ ...DEFAULTS, volume: "o'brien" }, { width: 8, height: 8 }, 'standard', 'http://localhost:1/x/');
  assert.match(command, /'http:\/\/localhost:1\/x\/v1\/volumes\/o'\\''brien\/frame'$/);
});

test('a transfer function is interpolated as the service does it', () => {
  const points = [{ value: 0, opacity: 0, color: '#000000' }, { value: 10, opacity: 0.5, color: '#ff0000' }, { value: 10, opacity: 1, color: '#00ff00' }];
  assert.deepEqual(sampled(points, 5), { value: 5, opacity: 0.25, color: '#800000' });
  assert.deepEqual(sampled(points, -1), { value: -1, opacity: 0, color: '#000000' });
  assert.equal(sampled(points, 10).opacity, 1);
  assert.equal(sampled(points, 11).color, '#00ff00');
});

test('points stay in order and opacities in range', () => {
  const transfer = { points: [0, 10, 20].map((value) => ({ value, opacity: 0.5, color: '#808080' })) };
  assert.equal(withChanged(transfer, 1, { value: 50 }).points[1].value, 20);
  assert.equal(withChanged(transfer, 1, { value: -50, opacity: 7 }).points[1].value, 0);
  assert.equal(withChanged(transfer, 1, { opacity: 7 }).points[1].opacity, 1);
  const [more, index] = withPoint(transfer, { value: 15, opacity: 0, color: '#000000' });
  assert.deepEqual([index, more.points.map(({ value }) => value)], [2, [0, 10, 15, 20]]);
});

test('a window moves and stretches all points', () => {
  const transfer = { points: [100, 150, 300].map((value) => ({ value, opacity: 0.5, color: '#808080' })) };
  const from = windowOf(transfer, 1);
  assert.deepEqual(from, { center: 200, width: 200 });
  assert.deepEqual(windowed(transfer, from, { center: 0, width: 400 }).points.map(({ value }) => value), [-200, -100, 200]);
});

test('small opacities have room', () => {
  assert.ok(heightOf(0.001) > 0.09);
  for (const opacity of [0, 0.001, 0.3, 1]) assert.ok(Math.abs(opacityOf(heightOf(opacity)) - opacity) < 1e-12);
});

test('numbers are as long as they matter', () => {
  assert.equal(short(123.456789, 4000), 123);
  assert.equal(short(0.123456789, 1), 0.123);
  assert.equal(short(1.23456789e-5, 1e-4), 1.23e-5);
  assert.deepEqual(ticks([-1024, 3071]), [-1000, 0, 1000, 2000, 3000]);
  assert.deepEqual(ticks([0, 255]), [0, 100, 200]);
});

test('server timings are read by name', () => {
  assert.deepEqual(readTimings('queue;dur=0.010, composite;dur=4.2, total;dur=10'), { queue: 0.01, composite: 4.2, total: 10 });
  assert.deepEqual(readTimings(''), {});
});

/** @type {(values: number[], opacities: number[]) => import('../../web/js/state.js').TransferFunction} */
const ramp = (values, opacities) => ({ points: values.map((value, i) => ({ value, opacity: opacities[i], color: '#ffffff' })), opacity_distance: 1 });
const PRESETS = /** @type {import('../../web/js/api.js').Preset[]} */ ([
  { name: 'both', title: 'Both', modality: ['CT'], values: 'file', shading: true, transfer_function: ramp([-700, 0, 900], [0, 0.1, 1]) },
  { name: 'bone', title: 'Bone', modality: ['CT'], values: 'file', shading: false, transfer_function: ramp([150, 900], [0, 1]) },
  { name: 'ramp', title: 'Ramp', modality: [], values: 'range', shading: false, transfer_function: ramp([0, 1], [0, 1]) },
  { name: 'brain', title: 'Brain', modality: ['MR'], values: 'range', shading: true, transfer_function: ramp([0, 1], [0, 1]) },
]);
const SCAN = /** @type {import('../../web/js/api.js').ReadyVolume} */ ({ modality: 'CT', default_preset: 'automatic', value_range: [0, 4000] });
/** @param {import('../../web/js/state.js').TransferFunction | null} own */
const looks = (own) => looksFor(PRESETS, SCAN, own && { preset: 'automatic', shading: true, transfer_function: own });

test('a scan in the presets’ units is offered them by name', () => {
  const { fitting, others } = looks(null);
  assert.deepEqual(fitting.map(({ transfer }) => transfer), [null, 'both', 'bone', 'ramp']);
  assert.deepEqual(others.map(({ transfer }) => transfer), ['brain']);
});

test('a scan whose units are shifted is offered shifted presets', () => {
  const { fitting } = looks(ramp([324.04, 1024.04, 1924.04], [0, 0.1, 1]));
  assert.deepEqual(fitting.map(({ name }) => name), ['', 'both', 'bone', 'ramp']);
  assert.deepEqual(fitting[2].transfer, ramp([1174.04, 1924.04], [0, 1]));
  assert.equal(fitting[2].shading, false);
  assert.equal(fitting[3].transfer, 'ramp', 'fractions of the range need no shift');
});

test('a scan without units is offered its surface and its densest parts', () => {
  const { fitting, others } = looks(ramp([15, 35, 64, 102, 120, 169], [0, 0.02, 0.02, 0.15, 0.9, 0.9]));
  assert.deepEqual(fitting.map(({ name }) => name), ['', 'surface', 'dense', 'ramp']);
  assert.deepEqual(fitting[1].transfer, ramp([15, 25, 169], [0, 0.9, 0.9]));
  assert.deepEqual(fitting[2].transfer, ramp([102, 120, 169], [0, 0.9, 0.9]));
  assert.deepEqual(others.map(({ name }) => name), ['both', 'bone', 'brain']);
});
