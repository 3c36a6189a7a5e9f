/**
 * @file For work on the viewer: web/ as it is on disk, everything else from a running service.
 *
 *     target/release/shearwarp serve --listen 127.0.0.1:8081
 *     node tests/viewer/serve.js http://127.0.0.1:8081 8080
 *
 * The service has the files built in, and nothing in it can read them from elsewhere; so a change would cost a build.
 */
import { once } from 'node:events';
import { readFile } from 'node:fs/promises';
import http from 'node:http';
import { extname } from 'node:path';
import { fileURLToPath } from 'node:url';

const WEB = fileURLToPath(new URL('../../web', import.meta.url));
/** @type {Record<string, string>} */
const TYPES = { '.html': 'text/html; charset=utf-8', '.css': 'text/css', '.js': 'text/javascript', '.svg': 'image/svg+xml' };
const POLICY = "default-src 'self'; img-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'";

/** @param {string} service its address @param {number} port 0 takes a free one @returns {Promise<http.Server>} */
export async function serve(service, port) {
  const server = http.createServer(async (request, response) => {
    const path = new URL(request.url ?? '/', 'http://localhost').pathname;
    const name = path === '/' ? '/index.html' : path;
    const file = TYPES[extname(name)] && !name.includes('..') ? await readFile(WEB + name).catch(() => null) : null;
    if (!file) return forward(service, request, response);
    response.writeHead(200, { 'Content-Type': TYPES[extname(name)], 'Content-Security-Policy': POLICY, 'Cache-Control': 'no-store' });
    response.end(file);
  });
  server.listen(port, '127.0.0.1');
  await once(server, 'listening');
  return server;
}

/** @param {string} service @param {http.IncomingMessage} request @param {http.ServerResponse} response */
function forward(service, request, response) {
  const { method, headers } = request;
  const forwarded = http.request(new URL(request.url ?? '/', service), { method, headers }, (answer) => {
    response.writeHead(answer.statusCode ?? 502, answer.headers);
    answer.pipe(response);
  });
  forwarded.on('error', () => response.headersSent || response.writeHead(502).end());
  // A viewer that gives a frame up ends the service's work on it.
  response.on('close', () => forwarded.destroy());
  request.pipe(forwarded);
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const [service, port = '8080'] = process.argv.slice(2);
  if (!service) {
    console.error('usage: node serve.js SERVICE [PORT]');
    process.exit(2);
  }
  await serve(service, Number(port));
  console.log(`listening on http://127.0.0.1:${port}`);
}
