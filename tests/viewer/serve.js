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
import net from 'node:net';
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
  server.on('upgrade', (request, socket, head) => tunnel(service, request, socket, head));
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

/**
 * A stream, byte by byte. `Host` stays what the browser said, as the service compares it with `Origin`.
 * @param {string} service @param {http.IncomingMessage} request @param {import('node:stream').Duplex} socket @param {Buffer} head
 */
function tunnel(service, { url, rawHeaders }, socket, head) {
  const { hostname, port } = new URL(service);
  const behind = net.connect(Number(port), hostname);
  const headers = rawHeaders.map((text, i) => text + (i % 2 ? '\r\n' : ': ')).join('');
  behind.write(`GET ${url} HTTP/1.1\r\n${headers}\r\n`);
  behind.write(head);
  socket.pipe(behind).pipe(socket);
  for (const [one, other] of [[socket, behind], [behind, socket]]) one.on('error', () => {}).on('close', () => other.destroy());
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
