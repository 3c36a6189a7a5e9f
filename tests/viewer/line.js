/** @file A slow line to a service: what goes in at one end comes out at the other after half the delay, in either direction. */
import { once } from 'node:events';
import net from 'node:net';

export class Line {
  /** @type {Set<net.Socket>} */ #ends = new Set();
  address = '';

  /** @param {string} service its address @param {number} delay ms, there and back; may be set anew */
  constructor(service, delay) {
    this.delay = delay;
    const { hostname, port } = new URL(service);
    this.server = net.createServer((near) => this.#join(near, net.connect(Number(port), hostname)));
  }

  /** @param {string} service @param {number} delay */
  static async open(service, delay) {
    const line = new Line(service, delay);
    line.server.listen(0, '127.0.0.1');
    await once(line.server, 'listening');
    line.address = `http://127.0.0.1:${/** @type {net.AddressInfo} */ (line.server.address()).port}`;
    return line;
  }

  /** @param {net.Socket} near @param {net.Socket} far */
  #join(near, far) {
    for (const [from, to] of [[near, far], [far, near]]) {
      this.#ends.add(from);
      from.setNoDelay(true);
      from.on('error', () => {});
      from.on('data', (bytes) => setTimeout(() => to.writable && to.write(bytes), this.delay / 2));
      from.on('close', () => {
        this.#ends.delete(from);
        setTimeout(() => to.destroy(), this.delay / 2);
      });
    }
  }

  close() {
    this.server.close();
    for (const end of this.#ends) end.destroy();
  }
}
