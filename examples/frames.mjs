// Frames in JavaScript, the same in a browser and in Node 20.   node frames.mjs [http://127.0.0.1:8080]
const service = globalThis.process?.argv[2] ?? 'http://127.0.0.1:8080';

/** A frame's bytes, and what each stage took in milliseconds. */
export async function frame(volume, request = {}) {
  const answer = await fetch(`${service}/v1/volumes/${volume}/frame`, {
    method: 'POST',
    headers: { 'Content-Type': 'application/json', Accept: 'image/webp' },
    body: JSON.stringify(request),
  });
  if (!answer.ok) throw new Error((await answer.json()).detail);
  const stages = answer.headers.get('Server-Timing').split(', ').map((stage) => stage.split(';dur='));
  return { picture: await answer.blob(), timing: Object.fromEntries(stages.map(([name, ms]) => [name, Number(ms)])) };
}

const { volumes } = await (await fetch(`${service}/v1/volumes`)).json();
for (const { id } of volumes) {
  const { picture, timing } = await frame(id, { camera: { azimuth: 30 }, image: { width: 512, height: 512 } });
  console.log(`${id}: ${picture.size} bytes of ${picture.type} in ${timing.total} ms`);
}
