#!/usr/bin/env python3
"""Turns a scan over one connection and keeps the last, refined frame.

    pip install websockets
    stream.py [ws://127.0.0.1:8080/v1/volumes/demo/stream] [frame.png]
"""
import asyncio, json, struct, sys, time
import websockets

URL = sys.argv[1] if len(sys.argv) > 1 else "ws://127.0.0.1:8080/v1/volumes/demo/stream"
OUT = sys.argv[2] if len(sys.argv) > 2 else "frame.png"


def split(message):
    """A frame's header and its bytes; what was refused is an error."""
    if isinstance(message, str):
        raise RuntimeError(json.loads(message)["error"]["detail"])
    (length,) = struct.unpack_from("<I", message)
    return json.loads(message[4:4 + length]), message[4 + length:]


async def main():
    async with websockets.connect(URL, max_size=None) as stream:
        start = time.perf_counter()
        await stream.send(json.dumps({"request": {"image": {"width": 512, "height": 512}}}))
        for azimuth in range(3, 183, 3):
            header, _ = split(await stream.recv())
            await stream.send(json.dumps({"patch": {"camera": {"azimuth": azimuth}}, "ack": header["sequence"]}))
        print(f"{60 / (time.perf_counter() - start):.0f} frames/s while turning")
        while not header["last"] or header["request"] < 61:
            header, frame = split(await stream.recv())
            await stream.send(json.dumps({"ack": header["sequence"]}))
            print(f"request {header['request']}, {header['quality']}: {header['timing']['total']} ms")
        open(OUT, "wb").write(frame)


asyncio.run(main())
