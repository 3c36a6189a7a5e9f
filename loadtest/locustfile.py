"""Concurrent clients that turn volumes and change transfer functions.

    locust -f loadtest/locustfile.py --headless -u 200 -r 50 -t 30s --host http://127.0.0.1:8080

Every answer 200 must be a whole PNG of the size that was asked for. 503 with Retry-After is how the
service says that its queue is full: it is counted on its own and waited out. Anything else is a
failure, and failures (or no frame at all) make the exit status 1. See docs/loadtest.md.
"""

import json
import random
import struct
import zlib

import gevent
from locust import FastHttpUser, events, task
from locust.exception import StopUser
from locust.runners import WorkerRunner

FRAME = "frame"
BUSY = "frame: 503, asked to wait"
SIZES = [(256, 256), (512, 512), (640, 480)]
# Where a ramp of opacity begins and ends, as shares of the volume's range. Few, so that
# classifications are shared by clients as they are in life, and more than one, so that they change.
RAMPS = [(0.1, 0.3), (0.2, 0.6), (0.4, 0.9)]


class Viewer(FastHttpUser):
    """One client: looks at one volume after another, from angles that advance as if dragged."""

    def on_start(self):
        listed = self.get_json("/v1/volumes", "volumes")
        self.volumes = [self.get_json(f"/v1/volumes/{v['id']}", "volume") for v in listed["volumes"]]
        if not self.volumes:
            raise StopUser()
        self.turn(random.choice(self.volumes))

    def get_json(self, path, name):
        with self.client.get(path, name=name, catch_response=True) as response:
            if response.status_code == 200:
                return json.loads(response.text)
            response.failure(f"expected 200, got {response.status_code}")
        raise StopUser()

    def turn(self, volume):
        """Starts over with a volume: a transfer function, a size, an angle."""
        self.volume = volume
        self.request = {"camera": {"elevation": random.uniform(-60, 60)}}
        self.size = random.choice(SIZES)
        self.azimuth = random.uniform(0, 360)
        ramp = random.choice([None, *RAMPS])
        if ramp:
            low, high = volume["value_range"]
            begin, end = (low + share * (high - low) for share in ramp)
            if begin < end:
                self.request["transfer_function"] = {
                    "points": [
                        {"value": begin, "opacity": 0, "color": "#000000"},
                        {"value": end, "opacity": 0.8, "color": random.choice(["#ffffff", "#ffcc99"])},
                    ]
                }

    @task
    def frame(self):
        if random.random() < 0.05:
            self.turn(random.choice(self.volumes))
        self.azimuth = (self.azimuth + random.uniform(1, 5)) % 360
        width, height = self.size
        self.request["camera"]["azimuth"] = self.azimuth
        self.request["image"] = {"width": width, "height": height, "format": "png"}
        path = f"/v1/volumes/{self.volume['id']}/frame"
        wait = 0
        with self.client.post(path, json=self.request, name=FRAME, catch_response=True) as response:
            if response.status_code == 200:
                problem = png_problem(response.content, width, height)
                if problem:
                    response.failure(problem)
            elif response.status_code == 503:
                wait = retry_after(response)
                if wait is None:
                    response.failure("expected Retry-After with 503, got none")
                else:
                    response.request_meta["name"] = BUSY
                    response.success()
            else:
                response.failure(f"expected 200 or 503, got {response.status_code}")
        if wait:
            # A little late and not all at once, as a polite client comes back.
            gevent.sleep(wait * random.uniform(1, 1.5))


def retry_after(response):
    """Seconds to wait, or None where the answer does not say."""
    try:
        return max(0, int(response.headers["Retry-After"]))
    except (KeyError, ValueError, TypeError):
        return None


def png_problem(data, width, height):
    """What is wrong with a PNG of this size; None where nothing is. Every chunk's checksum is tested."""
    if not data or data[:8] != b"\x89PNG\r\n\x1a\n":
        return "expected a PNG, got something else"
    at, kinds, pixels = 8, [], zlib.decompressobj()
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8 : at + 8 + length]
        (checksum,) = struct.unpack_from(">I", data, at + 8 + length) if at + 12 + length <= len(data) else (None,)
        if checksum != zlib.crc32(kind + body):
            return f"expected a whole PNG, got a broken chunk {kind!r}"
        if kind == b"IHDR" and struct.unpack_from(">II", body) != (width, height):
            return f"expected {width} x {height} pixels, got {struct.unpack_from('>II', body)}"
        if kind == b"IDAT":
            pixels.decompress(body)
        kinds.append(kind)
        at += 12 + length
    if not kinds or kinds[0] != b"IHDR" or kinds[-1] != b"IEND" or at != len(data) or not pixels.eof:
        return f"expected a whole PNG, got the chunks {kinds} and {len(data) - at} more bytes"
    return None


@events.quitting.add_listener
def report(environment, **_):
    """Prints what the run was for, and fails a run without frames."""
    if isinstance(environment.runner, WorkerRunner):
        return
    stats = environment.stats
    frames, busy = stats.get(FRAME, "POST"), stats.get(BUSY, "POST")
    answers = frames.num_requests + busy.num_requests
    good = frames.num_requests - frames.num_failures
    seconds = max(stats.total.last_request_timestamp or 0, stats.total.start_time) - stats.total.start_time
    percentile = lambda share: frames.get_response_time_percentile(share) if frames.num_requests else 0
    print(
        f"\nframes {good} in {seconds:.1f} s: {good / seconds if seconds else 0:.1f} per second"
        f"\np50 {percentile(0.5)} ms, p99 {percentile(0.99)} ms (waiting in the service's queue included)"
        f"\n503 {busy.num_requests} of {answers} answers: {100 * busy.num_requests / answers if answers else 0:.1f} %"
        f"\nfailures {stats.total.num_failures}"
    )
    if stats.total.num_failures or not good:
        environment.process_exit_code = 1
