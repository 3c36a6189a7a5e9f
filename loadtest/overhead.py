"""What HTTP adds to a frame, and how many frames a second come out of it.

    python3 loadtest/overhead.py --host 127.0.0.1:8080 [--volume demo] [--frames 200] [--clients 16] [--seconds 10] [--query quality=draft]

First one client on one connection that it keeps: each answer's time as the client sees it, less the
`total` that the answer itself tells in Server-Timing. Then several clients at once, each with its own
connection and asking again as soon as it is answered: frames a second. To compare with `shearwarp
bench`, run that on the same volume with the same size and transfer function, on an otherwise idle
machine, and take turns: both depend on what else runs. Needs nothing but Python.
"""
import argparse
import http.client
import statistics
import threading
import time


def frame(connection, volume, query, azimuth):
    """Seconds that the answer took, and the milliseconds that it tells by stage."""
    start = time.perf_counter()
    connection.request("GET", f"/v1/volumes/{volume}/frame.png?width=512&height=512&azimuth={azimuth:.3f}&{query}")
    response = connection.getresponse()
    body = response.read()
    took = time.perf_counter() - start
    if response.status != 200 or not body.startswith(b"\x89PNG"):
        raise SystemExit(f"expected a frame, got {response.status}: {body[:200]!r}")
    stages = (entry.split(";dur=") for entry in response.headers["Server-Timing"].split(", "))
    return took, {stage: float(ms) for stage, ms in stages}


def one_client(options):
    connection = http.client.HTTPConnection(options.host)
    for turn in range(2):  # the first to warm up
        over, totals, stages = [], [], {}
        for n in range(options.frames):
            took, told = frame(connection, options.volume, options.query, n * 360 / options.frames)
            totals.append(told["total"])
            over.append(took * 1000 - told["total"])
            for stage, ms in told.items():
                stages.setdefault(stage, []).append(ms)
    over.sort()
    print(f"one client: total median {statistics.median(totals):.3f} ms, mean {statistics.mean(totals):.3f} ms")
    print("  " + ", ".join(f"{stage} {statistics.median(ms):.3f}" for stage, ms in stages.items()))
    print(f"  over it: min {over[0]:.3f}, median {statistics.median(over):.3f}, p90 {over[len(over) * 9 // 10]:.3f} ms")


def many_clients(options):
    counts, begin, end = [0] * options.clients, time.perf_counter() + 1, time.perf_counter() + 1 + options.seconds

    def client(n):
        connection, azimuth = http.client.HTTPConnection(options.host), n * 360 / options.clients
        while time.perf_counter() < end:
            frame(connection, options.volume, options.query, azimuth % 360)
            counts[n] += begin <= time.perf_counter() < end
            azimuth += 4

    threads = [threading.Thread(target=client, args=(n,)) for n in range(options.clients)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    print(f"{options.clients} clients: {sum(counts) / options.seconds:.1f} frames/s")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--host", default="127.0.0.1:8080")
    parser.add_argument("--volume", default="demo")
    parser.add_argument("--query", default="")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--clients", type=int, default=16)
    parser.add_argument("--seconds", type=float, default=10)
    options = parser.parse_args()
    one_client(options)
    many_clients(options)


if __name__ == "__main__":
    main()
