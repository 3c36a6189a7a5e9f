/**
 * @file The picture: the newest frame, laid where the camera now says it belongs.
 *
 * A frame is as old as its way here. Until the next one comes, the last one is moved, turned and enlarged as the
 * camera was ({@link carried}): exactly what a pan, a zoom or a roll would show, and close to it for
 * a small turn. So the picture answers at once on any line. A client that warps intermediate images
 * itself would do so here.
 */
import { carried } from './camera.js';

/** @import {Frame} from './frames.js' */

/** Pixels of a full frame at most: beyond, a screen's finest pixels cost more than they show. */
const MOST_PIXELS = 2_000_000;

export class View {
  /** @type {Frame | null} */ #frame = null;
  #waiting = 0;
  /** What a person looks at has another size. */
  onResize = () => {};

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {import('./state.js').Store} store
   * @param {() => import('./camera.js').Sphere | null} sphere of the scan that the state names
   */
  constructor(canvas, store, sphere) {
    this.canvas = canvas;
    this.store = store;
    this.sphere = sphere;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext('2d'));
    new ResizeObserver(() => this.#resize()).observe(canvas);
    store.subscribe(() => this.redraw());
  }

  /** Pixels of the screen that the picture covers, within reason. @returns {{width: number, height: number}} */
  size() {
    const { clientWidth, clientHeight } = this.canvas;
    const dense = Math.min(window.devicePixelRatio, Math.sqrt(MOST_PIXELS / Math.max(1, clientWidth * clientHeight)));
    return { width: Math.max(1, Math.round(clientWidth * dense)), height: Math.max(1, Math.round(clientHeight * dense)) };
  }

  /** @param {Frame} frame */
  show(frame) {
    this.#frame?.bitmap.close();
    this.#frame = frame;
    this.redraw();
  }

  /** The frame in sight. */
  get frame() {
    return this.#frame;
  }

  /** Draws before the screen is next painted. */
  redraw() {
    this.#waiting ||= requestAnimationFrame(() => {
      this.#waiting = 0;
      this.#draw();
    });
  }

  #resize() {
    const { width, height } = this.size();
    if (this.canvas.width === width && this.canvas.height === height) return;
    [this.canvas.width, this.canvas.height] = [width, height];
    this.#draw();
    this.onResize();
  }

  #draw() {
    const { context, canvas, store: { state } } = this;
    const frame = this.#frame;
    const sphere = this.sphere();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    if (state.background !== 'transparent') {
      context.fillStyle = state.background;
      context.fillRect(0, 0, canvas.width, canvas.height);
    }
    if (!frame || !sphere || frame.state.volume !== state.volume) return;
    const { width, height } = frame.bitmap;
    if (frame.state.camera === state.camera && width === canvas.width && height === canvas.height) {
      context.drawImage(frame.bitmap, 0, 0);
      return;
    }
    const half = Math.min(canvas.width, canvas.height) / 2;
    const halfFrame = Math.min(width, height) / 2;
    context.translate(canvas.width / 2, canvas.height / 2);
    context.scale(half, half);
    context.transform(...carried(frame.state.camera, state.camera, sphere));
    context.drawImage(frame.bitmap, -width / 2 / halfFrame, -height / 2 / halfFrame, width / halfFrame, height / halfFrame);
  }
}
