/**
 * @file A service of the test's own: started on a free port with the built-in scan, and stopped.
 *
 * With `WEB=disk` in the environment the viewer's files come from web/ and not from the program: for work on them.
 */
import { spawn } from 'node:child_process';
import { existsSync, statSync } from 'node:fs';
import { once } from 'node:events';
import http from 'node:http';
import { createInterface } from 'node:readline';
import { fileURLToPath } from 'node:url';
import { serve } from './serve.js';

/** Nothing here takes as long, except where it hangs. */
const PATIENCE = 60_000;

/** What was built last. */
function binary() {
  const built = ['debug', 'release'].map((profile) => fileURLToPath(new URL(`../../target/${profile}/shearwarp`, import.meta.url)));
  const [newest] = built.filter((path) => existsSync(path)).sort((a, b) => statSync(b).mtimeMs - statSync(a).mtimeMs);
  if (!newest) throw new Error('there is no shearwarp in target/debug or target/release: cargo build');
  return newest;
}

export class Service {
  /** @type {import('node:child_process').ChildProcess | null} */ #process = null;
  /** @type {import('node:http').Server | null} */ #front = null;
  /** Where a browser goes. */ address = '';

  /** @param {string} [listen] address and port; a free one unless told @param {Record<string, string>} [env] configuration */
  static async start(listen = '127.0.0.1:0', env = {}) {
    const service = new Service();
    await service.#start(listen, env);
    return service;
  }

  /** @param {string} listen @param {Record<string, string>} env */
  async #start(listen, env) {
    const child = spawn(binary(), ['serve', '--listen', listen], { stdio: ['ignore', 'pipe', 'ignore'], env: { ...process.env, ...env } });
    this.#process = child;
    const lines = createInterface({ input: child.stdout });
    const [line] = await once(lines, 'line', { signal: AbortSignal.timeout(PATIENCE) });
    this.address = String(line).replace('listening on ', '');
    // A test that fails before it stops its service keeps the run from its end no longer, and leaves no service behind.
    child.unref();
    /** @type {import('node:net').Socket} */ (child.stdout).unref();
    process.once('exit', () => child.kill());
    for (const start = Date.now(); !(await fetch(`${this.address}/readyz`)).ok; ) {
      if (Date.now() - start > PATIENCE) throw new Error('the service is never ready');
      await new Promise((resolve) => setTimeout(resolve, 100));
    }
    if (process.env.WEB !== 'disk') return;
    this.#front = await serve(this.address, 0);
    this.address = `http://127.0.0.1:${/** @type {import('node:net').AddressInfo} */ (this.#front.address()).port}`;
  }

  /** Opens a stream and leaves it open. @returns {Promise<() => void>} ends it */
  async hold() {
    const headers = { Connection: 'Upgrade', Upgrade: 'websocket', 'Sec-WebSocket-Version': '13', 'Sec-WebSocket-Key': 'c2l4dGVlbiBieXRlcyEhIQ==' };
    const asked = http.get(`${this.address}/v1/volumes/demo/stream`, { headers });
    const [, socket] = await once(asked, 'upgrade');
    return () => socket.destroy();
  }

  /** Requests that wait for their turn. @returns {Promise<number>} */
  async waiting() {
    const metrics = await (await fetch(`${this.address}/metrics`)).text();
    return Number(/^shearwarp_queue_depth (\S+)/m.exec(metrics)?.[1] ?? 0);
  }

  async stop() {
    this.#front?.closeAllConnections();
    this.#front?.close();
    const child = this.#process;
    this.#process = null;
    if (!child || child.exitCode !== null) return;
    child.ref();
    child.kill('SIGTERM');
    await once(child, 'exit');
  }
}
