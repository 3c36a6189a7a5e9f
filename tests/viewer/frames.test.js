/** @file Which frames are asked for, with a service whose answers the test gives. */
import assert from 'node:assert/strict';
import { mock, test } from 'node:test';
import { Problem } from '../../web/js/api.js';
import { Frames } from '../../web/js/frames.js';
import { DEFAULTS } from '../../web/js/state.js';

/** @typedef {import('../../web/js/state.js').State} State */
/** @typedef {{state: State, size: {width: number, height: number}, stage: string, signal: AbortSignal, answer: (cost?: number) => Promise<void>, fail: (problem: Problem) => Promise<void>}} Asked */

/** Lets everything run that waits for nothing but promises. */
const settle = async () => {
  for (let i = 0; i < 10; i++) await Promise.resolve();
};

/** Frames over a service in the test's hands. @param {Partial<State>} [patch] */
function scheduler(patch = {}) {
  mock.timers.enable({ apis: ['setTimeout'] });
  let now = 0;
  mock.method(performance, 'now', () => now);
  // @ts-expect-error: pictures are of no interest here, and this is no browser
  globalThis.createImageBitmap = async () => ({ close() {} });
  /** @type {Asked[]} */ const asked = [];
  /** @type {string[]} */ const shown = [];
  /** @type {(Problem | null)[]} */ const problems = [];
  let state = { ...DEFAULTS, volume: 'head', ...patch };
  const frames = new Frames(() => state, () => ({ width: 100, height: 80 }), (state, size, stage, signal) =>
    new Promise((resolve, reject) => {
      signal.addEventListener('abort', () => reject(signal.reason));
      asked.push({
        state, size, stage, signal,
        answer: (cost = 20) => (resolve(/** @type {any} */ ({ stages: { total: cost }, downloaded: 0 })), settle()),
        fail: (problem) => (reject(problem), settle()),
      });
    }));
  frames.onFrame.push(({ state, stage }) => shown.push(`${state.background} ${stage}`));
  frames.onProblem = (/** @type {Problem | null} */ problem) => void problems.push(problem);
  const pass = async (/** @type {number} */ ms) => {
    now += ms;
    mock.timers.tick(ms);
    await settle();
  };
  const change = (/** @type {string} */ background, moving = true) => {
    state = { ...state, background };
    frames.changed(moving);
  };
  return { frames, asked, shown, problems, pass, change, stages: () => asked.map(({ state, stage }) => `${state.background} ${stage}`) };
}

/** @param {string} name @param {() => Promise<void>} claim */
const timed = (name, claim) => test(name, async () => {
  try {
    await claim();
  } finally {
    mock.timers.reset();
    mock.restoreAll();
  }
});

timed('of many moves the newest is asked for, two at a time', async () => {
  const { asked, shown, change, stages } = scheduler();
  for (const move of 'abcdef') change(move);
  assert.deepEqual(stages(), ['a draft', 'b draft']);
  await asked[0].answer();
  assert.deepEqual(stages(), ['a draft', 'b draft', 'f draft']);
  await asked[2].answer();
  await asked[1].answer();
  assert.deepEqual(shown, ['a draft', 'f draft'], 'what comes late is not shown');
});

timed('dear frames are asked for one at a time', async () => {
  const { asked, change, stages } = scheduler();
  change('a');
  await asked[0].answer(2000);
  for (const move of 'bcd') change(move);
  assert.deepEqual(stages(), ['a draft', 'b draft']);
});

timed('a view at rest is refined, and the next move ends that', async () => {
  const { asked, shown, change, pass, stages } = scheduler();
  change('a');
  await asked[0].answer();
  await pass(99);
  assert.equal(asked.length, 1);
  await pass(1);
  assert.deepEqual(stages(), ['a draft', 'a standard']);
  await asked[1].answer();
  assert.equal(asked[2].stage, 'high');
  change('b');
  assert.ok(asked[2].signal.aborted);
  assert.deepEqual(stages().at(-1), 'b draft');
  assert.deepEqual(shown, ['a draft', 'a standard']);
});

timed('a change for good needs no draft', async () => {
  const { asked, change, stages, frames } = scheduler({ quality: 'standard' });
  change('a', false);
  await asked[0].answer();
  assert.deepEqual(stages(), ['a standard']);
  assert.ok(frames.idle);
});

timed('high that nobody asked for is given up when it is slow, and not tried again', async () => {
  const { asked, change, pass, stages } = scheduler();
  change('a', false);
  await asked[0].answer();
  await pass(3000);
  assert.ok(asked[1].signal.aborted);
  change('b', false);
  await asked[2].answer();
  assert.deepEqual(stages(), ['a standard', 'a high', 'b standard']);
});

timed('high that was asked for may take its time', async () => {
  const { asked, change, pass, shown } = scheduler({ quality: 'high' });
  change('a', false);
  await asked[0].answer();
  await pass(60_000);
  assert.equal(asked[1].signal.aborted, false);
  await asked[1].answer();
  assert.deepEqual(shown, ['a standard', 'a high']);
});

timed('algorithms without high are not asked for it', async () => {
  const { asked, change, stages } = scheduler({ algorithm: 'classified', quality: 'high' });
  change('a', false);
  await asked[0].answer();
  assert.deepEqual(stages(), ['a standard']);
});

timed('a busy service is left alone for as long as it says', async () => {
  const { asked, change, pass, problems, shown } = scheduler();
  change('a', false);
  await asked[0].fail(new Problem('busy', 'full', { retryAfter: 2 }));
  assert.equal(problems.at(-1)?.kind, 'busy');
  for (const move of 'bcd') change(move);
  await pass(1900);
  assert.equal(asked.length, 1);
  await pass(1000);
  assert.equal(asked.length, 2);
  await asked[1].answer();
  assert.deepEqual([problems.at(-1), shown], [null, ['d standard']]);
});

timed('a service that is gone is asked again after 1, 2, 4 and at most 8 seconds', async () => {
  const { asked, change, pass, problems } = scheduler();
  change('a', false);
  for (const seconds of [1, 2, 4, 8, 8]) {
    await asked.at(-1)?.fail(new Problem('gone', 'no answer'));
    assert.equal(problems.at(-1)?.retryAfter, seconds);
    const before = asked.length;
    await pass(seconds * 1250);
    assert.equal(asked.length, before + 1);
  }
});

timed('a refused view is not asked for again, another is', async () => {
  const { asked, change, pass, problems } = scheduler();
  change('a', false);
  await asked[0].fail(new Problem('refused', 'no', { errors: [{ pointer: '/camera', detail: 'no' }] }));
  await pass(60_000);
  assert.equal(asked.length, 1);
  assert.equal(problems.at(-1)?.errors[0].pointer, '/camera');
  change('b', false);
  assert.equal(asked.length, 2);
});

timed('drafts shrink where they are dear and grow where they are cheap', async () => {
  const { asked, change, pass } = scheduler({ quality: 'draft' });
  const draft = async (/** @type {number} */ cost) => {
    change(String(asked.length));
    const last = asked[asked.length - 1];
    await last.answer(cost);
    await pass(1);
    return last.size.width;
  };
  assert.equal(await draft(200), 100);
  let width = 100;
  for (let i = 0; i < 20; i++) width = await draft(200);
  assert.equal(width, 35);
  for (let i = 0; i < 40; i++) width = await draft(5);
  assert.equal(width, 100);
});

timed('another scan drops what is under way', async () => {
  const { asked, change, frames } = scheduler();
  change('a');
  frames.dropAll();
  assert.ok(asked[0].signal.aborted);
  change('b', false);
  assert.equal(asked.at(-1)?.stage, 'standard');
});
