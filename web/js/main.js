/** @file The viewer's parts, made and joined. Everything else happens through the store. */
import { Problem, fitted, frame, histogram, listPresets, listVolumes } from './api.js';
import { ANATOMICAL, between, boundingSphere, described } from './camera.js';
import { Cube } from './cube.js';
import { CutPanel } from './cut-panel.js';
import { byId, iconButton, takeIcons } from './dom.js';
import { Frames } from './frames.js';
import { Handles } from './handles.js';
import { Input } from './input.js';
import { LightPanel } from './light-panel.js';
import { fromHash, toHash } from './link.js';
import { Look } from './look.js';
import { LookPanel } from './look-panel.js';
import { AUTOMATIC } from './looks.js';
import { Messages } from './messages.js';
import { tabs, themeButton, tools } from './page.js';
import { PresetList } from './presets.js';
import { renderRequest } from './request.js';
import { ScanPanel } from './scan-panel.js';
import { Share } from './share.js';
import { DEFAULT_CAMERA, Store } from './state.js';
import { Stream } from './stream.js';
import { Thumbnails } from './thumbnails.js';
import { Timings } from './timings.js';
import { TransferEditor } from './transfer-editor.js';
import { View } from './view.js';
import { ViewPanel } from './view-panel.js';

/** @import {Volume, ReadyVolume} from './api.js' */

/** Milliseconds from the last change until the address has it. */
const LINK_PAUSE = 250;
/** Milliseconds of a turn to an anatomical view. */
const TURN = 260;
/** Milliseconds between looks at scans that are being loaded. */
const LOADING_PAUSE = 1500;

/** @type {Volume[]} */
let volumes = [];
const store = new Store(fromHash(location.hash));

/** The scan that the state names. @returns {ReadyVolume | null} */
function volume() {
	const named = volumes.find(({ id, status }) => id === store.state.volume && status === 'ready');
	return /** @type {ReadyVolume | undefined} */ (named) ?? null;
}

const sphere = () => {
	const ready = volume();
	return ready && boundingSphere(ready);
};

const view = new View(byId('view'), /** @type {HTMLCanvasElement} */ (byId('picture')), store, sphere);
const stream = new Stream((state, size, stage, signal) => frame(state.volume, renderRequest(state, size, stage, true), signal));
const frames = new Frames(() => store.state, () => view.size(), stream.source);
const messages = new Messages(byId('messages'), byId('spoken'), () => (volumes.length ? frames.retry() : void load()));
const thumbnails = new Thumbnails(() => frames.idle);
const look = new Look(store, volume);
const editor = new TransferEditor(look);
const presets = new PresetList(store, thumbnails);
const timings = new Timings();
const scans = new ScanPanel(store, thumbnails, open);
const cut = new CutPanel(store, volume);
const handles = new Handles(store, sphere, () => (cut.element.checkVisibility() ? cut.handles() : []));
const input = new Input(byId('view'), store, sphere, handles, look, lookFrom);
const share = new Share(store, () => view.size(), messages, /** @type {HTMLDialogElement} */ (byId('dialog')));

frames.onFrame.push((shown) => view.show(shown), (shown) => timings.add(shown), (shown) => {
	// What is in sight, for scripts that wait for it: empty while the view has moved on.
	if (shown.state === store.state) byId('view').dataset.stage = shown.stage;
});
frames.onProblem = (/** @type {Problem | null} */ problem) => messages.show(problem?.kind === 'missing' ? missing() : problem);
frames.onRefining = (/** @type {boolean} */ busy) => byId('view').classList.toggle('refining', busy);
view.onResize = () => changed(false);

byId('overlay').append(handles.element, new Cube(store, lookFrom).element, timings.element);
const openTab = tabs(byId('tabs'), byId('panels'), [
	{ name: 'scan', label: 'Scan', content: scans.element },
	{ name: 'look', label: 'Look', content: new LookPanel(store, look, editor, presets.element).element },
	{ name: 'light', label: 'Light', content: new LightPanel(store, look).element },
	{ name: 'cut', label: 'Cut', content: cut.element },
	{ name: 'view', label: 'View', content: new ViewPanel(store, input, look).element },
], () => {
	thumbnails.wake();
	handles.draw();
});
tools((tool) => (input.tool = tool));
byId('head').append(
	iconButton('link', 'Copy a link to this view', () => share.copyLink(), { id: 'copy-link' }),
	iconButton('terminal', 'Copy as a curl command', () => share.copyCurl()),
	iconButton('save', 'Save a picture or a turntable', () => share.savePicture()),
	themeButton(),
	iconButton('help', 'Help', () => share.help()),
);
byId('scan-name').addEventListener('click', () => openTab('scan'));
document.addEventListener('keydown', (event) => {
	if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== 'z' || event.target instanceof HTMLTextAreaElement) return;
	event.preventDefault();
	if (event.shiftKey) look.redo();
	else look.undo();
});

/** What is wrong with a link to a scan that is not there. */
const missing = () => new Problem('missing', `There is no scan “${store.state.volume}”. The list has those that there are.`);

/** Another picture is wanted. @param {boolean} moving */
function changed(moving) {
	byId('view').dataset.stage = '';
	frames.changed(moving);
}

let linking = 0;
let written = '';
store.subscribe((state, before, moving) => {
	if (state.volume !== before.volume) frames.dropAll();
	changed(moving);
	clearTimeout(linking);
	linking = setTimeout(() => {
		written = toHash(state);
		history.replaceState(null, '', written);
		byId('view').setAttribute('aria-label', `${volume()?.name ?? 'The scan'}, ${described(state.camera)}${state.plane || state.box ? ', cut open' : ''}`);
	}, LINK_PAUSE);
});
window.addEventListener('hashchange', () => {
	if (location.hash === written) return;
	const state = fromHash(location.hash);
	store.set({ ...state, volume: state.volume || store.state.volume });
	enter();
});

/** Another scan, as it looks unless told. @param {string} id */
function open(id) {
	if (id === store.state.volume) return;
	const { projection, fov_y, azimuth, elevation, roll } = store.state.camera;
	const camera = { ...DEFAULT_CAMERA, projection, fov_y, azimuth, elevation, roll };
	store.set({ volume: id, camera, transfer: null, shading: null, window: null, plane: null, box: null, lens: null });
	const window = look.firstWindow(store.state.blend);
	if (window) store.set({ window });
	enter();
}

/** The scan whose panels are filled. */
let entered = '';

/** Shows what is known about the scan that the state names. */
async function enter() {
	scans.show(volumes);
	const named = volumes.find(({ id }) => id === store.state.volume);
	byId('scan-name').lastElementChild?.replaceChildren(named?.name ?? (store.state.volume || 'No scan'));
	document.title = `${named?.name ?? 'Scans'} – shearwarp`;
	const ready = volume();
	if (!ready && named?.status !== 'loading') openTab('scan');
	if (!ready || ready.id === entered) return;
	entered = ready.id;
	look.refresh();
	cut.show();
	editor.setHistogram(null);
	const own = ready.default_preset === AUTOMATIC ? fitted(ready.id, null) : null;
	const [automatic, counted] = await Promise.all([own?.catch(() => null) ?? null, histogram(ready.id).catch(() => null)]);
	if (volume()?.id !== ready.id) return;
	cut.setLooks(presets.setVolume(ready, automatic));
	editor.setHistogram(counted);
}

/** Turns to an anatomical view; at once for those who want no motion. @param {keyof typeof ANATOMICAL} name */
function lookFrom(name) {
	const { azimuth, elevation } = ANATOMICAL[name];
	const to = { azimuth, elevation, roll: 0 };
	const from = store.state.camera;
	const start = performance.now();
	const still = matchMedia('(prefers-reduced-motion: reduce)').matches;
	const step = () => {
		const part = still ? 1 : Math.min(1, (performance.now() - start) / TURN);
		const eased = part * part * (3 - 2 * part);
		store.setCamera(part < 1 ? between(from, to, eased) : to, part < 1);
		const expected = store.state.camera;
		// Whoever takes hold of the scan on its way there keeps it.
		if (part < 1) requestAnimationFrame(() => store.state.camera === expected && step());
	};
	step();
}

/** Finds out what there is, again and again while scans are being loaded. */
async function load() {
	try {
		const [all, listed] = await Promise.all([listVolumes(), listPresets()]);
		volumes = all;
		presets.setPresets(listed);
		messages.show(all.length ? null : new Problem('missing', 'The service has none; its log says why.'));
	} catch (error) {
		const problem = error instanceof Problem ? error : new Problem('failed', String(error));
		messages.show(problem);
		if (problem.passing) loadAfter(1000 * problem.retryAfter);
		return;
	}
	const known = volumes.some(({ id }) => id === store.state.volume);
	const first = volumes.find(({ status }) => status === 'ready') ?? volumes[0];
	if (!store.state.volume && first) store.set({ volume: first.id });
	else changed(false);
	if (!known && first && store.state.volume !== first.id) messages.show(missing());
	await enter();
	if (volumes.some(({ status }) => status === 'loading')) loadAfter(LOADING_PAUSE);
}

/** @param {number} ms and until somebody looks */
const loadAfter = (ms) => setTimeout(() => (document.hidden ? document.addEventListener('visibilitychange', load, { once: true }) : load()), ms);

function seen() {
	frames.pause(document.hidden);
	if (document.hidden) stream.close();
}
document.addEventListener('visibilitychange', seen);
seen();

openTab('look');
takeIcons().catch(() => {}); // Labels and titles say the same.
load();
