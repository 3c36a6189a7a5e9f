/** @file Frames over a connection whose other end the test holds. */
import assert from 'node:assert/strict';
import { mock, test } from 'node:test';
import { Problem } from '../../web/js/api.js';
import { DEFAULTS } from '../../web/js/state.js';
import { Stream } from '../../web/js/stream.js';

/** @typedef {import('../../web/js/frames.js').Stage} Stage */

const SIZE = { width: 100, height: 80 };
/** @type {Socket[]} */ let sockets = [];

/** What the viewer uses of a WebSocket. */
class Socket {
  static CONNECTING = 0;
  static OPEN = 1;
  readyState = 0;
  /** @type {any[]} */ heard = [];
  /** @type {any} */ onopen;
  /** @type {any} */ onclose;
  /** @type {any} */ onmessage;

  /** @param {string} address */
  constructor(address) {
    this.address = address;
    sockets.push(this);
  }
  /** @param {string} text */
  send(text) {
    this.heard.push(JSON.parse(text));
  }
  close() {
    this.readyState = 3;
  }
  open() {
    this.readyState = 1;
    this.onopen?.();
  }
  /** @param {number} request @param {number} sequence @param {number} total */
  frame(request, sequence, total = 5) {
    const header = new TextEncoder().encode(JSON.stringify({ sequence, request, format: 'png', algorithm: 'preintegrated', timing: { total } }));
    const data = new Uint8Array(4 + header.length + 1);
    new DataView(data.buffer).setUint32(0, header.length, true);
    data.set(header, 4);
    data[4 + header.length] = sequence;
    this.onmessage?.({ data: data.buffer });
  }
  /** @param {number} request the last that was taken @param {number} status @param {string} detail */
  refuse(request, status, detail) {
    this.onmessage?.({ data: JSON.stringify({ request, error: { status, detail } }) });
  }
}

const settle = async () => {
  for (let i = 0; i < 10; i++) await Promise.resolve();
};

/** @param {string} name @param {(service: ReturnType<typeof setup>) => Promise<void>} claim */
const claimed = (name, claim) => test(name, async () => {
  try {
    await claim(setup());
  } finally {
    mock.timers.reset();
    mock.restoreAll();
  }
});

function setup() {
  mock.timers.enable({ apis: ['setTimeout'] });
  let now = 0;
  mock.method(performance, 'now', () => now);
  sockets = [];
  // @ts-expect-error: this is no browser
  [globalThis.WebSocket, globalThis.document] = [Socket, { baseURI: 'https://host/below/' }];
  /** @type {string[]} */ const overHttp = [];
  const stream = new Stream(async (state, _size, stage) => {
    overHttp.push(`${state.volume} ${stage}`);
    return { blob: new Blob(), stages: {}, algorithm: 'http', downloaded: 0 };
  });
  /** What became of each question, in the order of the answers. @type {string[]} */ const answers = [];
  const ask = (/** @type {Stage} */ stage, volume = 'head') => {
    const abort = new AbortController();
    const answer = stream.source({ ...DEFAULTS, volume }, SIZE, stage, abort.signal);
    void answer.then(
      async (answer) => {
        answers.push(answer ? `${stage} ${answer.algorithm}` : 'passed over');
        answer?.drawn?.();
      },
      (error) => answers.push(error instanceof Problem ? `${error.kind} ${error.message}` : String(error)),
    );
    return abort;
  };
  const pass = async (/** @type {number} */ ms) => {
    now += ms;
    mock.timers.tick(ms);
    await settle();
  };
  /** A connection that is open. */
  const open = async (volume = 'head') => {
    ask('draft', volume);
    await settle();
    sockets.at(-1)?.open();
    answers.length = overHttp.length = 0;
    return sockets[sockets.length - 1];
  };
  return { stream, overHttp, answers, ask, pass, open };
}

claimed('a connection is opened behind the first frame, and has one frame a request', async ({ overHttp, answers, ask, open }) => {
  const socket = await open('a b');
  assert.equal(socket.address, 'wss://host/below/v1/volumes/a%20b/stream');
  ask('draft', 'a b');
  await settle();
  assert.deepEqual([socket.heard[0].moving, socket.heard[0].request.quality], ['draft', 'draft']);
  assert.deepEqual(answers, []);
  socket.frame(1, 1);
  await settle();
  assert.deepEqual([answers, overHttp, socket.heard[1]], [['draft preintegrated'], [], { ack: 1 }]);
});

claimed('another scan has another connection', async ({ overHttp, ask, open }) => {
  const first = await open();
  ask('standard', 'foot');
  await settle();
  assert.deepEqual([first.readyState, overHttp, sockets.length], [3, ['foot standard'], 2]);
  assert.match(sockets[1].address, /foot/);
});

claimed('what a newer request took the place of is passed over, and what nobody waits for is acknowledged', async ({ answers, ask, open }) => {
  const socket = await open();
  ask('draft');
  ask('draft').abort();
  ask('draft');
  socket.frame(3, 1);
  socket.frame(2, 2);
  await settle();
  assert.deepEqual(answers.sort(), ['draft preintegrated', 'passed over', 'passed over']);
  assert.deepEqual(socket.heard.slice(3).map(({ ack }) => ack).sort(), [1, 2]);
});

claimed('a refused request is not counted', async ({ answers, ask, open }) => {
  const socket = await open();
  for (let i = 0; i < 3; i++) ask('draft');
  socket.frame(1, 1);
  socket.refuse(1, 422, 'no');
  await settle();
  assert.deepEqual(answers, ['draft preintegrated', 'refused no']);
  socket.frame(2, 2);
  ask('standard');
  socket.frame(3, 3);
  await settle();
  assert.deepEqual(answers.slice(2), ['draft preintegrated', 'standard preintegrated']);
  ask('high');
  socket.refuse(4, 500, 'broken');
  await settle();
  assert.equal(answers[4], 'failed broken');
});

claimed('a refinement that is given up is ended, at once or when the service is willing', async ({ answers, ask, open, pass }) => {
  const socket = await open();
  // Young: the draft is said again.
  const young = ask('high');
  await pass(20);
  young.abort();
  ask('draft');
  await pass(100);
  assert.deepEqual(socket.heard.map(({ moving }) => moving), ['high', 'draft', 'draft']);
  socket.frame(2, 1);
  await settle();
  assert.deepEqual(answers, ['passed over', 'draft preintegrated']);
  socket.frame(3, 2);
  // Old: the draft itself ends it.
  const old = ask('high');
  await pass(500);
  const before = socket.heard.length;
  old.abort();
  ask('draft');
  await pass(500);
  assert.equal(socket.heard.length, before + 1);
  socket.frame(5, 3);
  // Too slow, and nothing else is asked for.
  const slow = ask('high');
  await pass(3000);
  slow.abort();
  await pass(0);
  assert.deepEqual(socket.heard.at(-1), { patch: { quality: 'draft' }, moving: 'draft' });
  ask('draft');
  socket.frame(8, 4);
  await settle();
  assert.equal(answers.at(-1), 'draft preintegrated');
});

claimed('where the connection ends or is dead HTTP answers, and another one is tried later and later', async ({ overHttp, answers, ask, open, pass }) => {
  const socket = await open();
  ask('draft');
  socket.onclose();
  await settle();
  assert.deepEqual([overHttp, answers], [['head draft'], ['draft http']]);
  for (const [pause, opened] of [[900, 1], [400, 2], [900, 2], [1700, 3], [2400, 3], [2700, 4]]) {
    await pass(pause);
    ask('draft');
    await settle();
    assert.equal(sockets.length, opened, `after ${pause} ms`);
    if (sockets[opened - 1].readyState === 0) sockets[opened - 1].onclose?.();
  }
  await pass(60_000);
  ask('draft');
  await settle();
  const dead = sockets[sockets.length - 1];
  dead.open();
  answers.length = 0;
  ask('standard');
  await pass(10_000);
  assert.deepEqual([answers, dead.readyState], [['standard http'], 3]);
});
