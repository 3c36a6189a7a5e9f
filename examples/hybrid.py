#!/usr/bin/env python3
"""A mesh of one's own inside a volume: rendered here by a small z-buffer rasterizer, merged by the service.

    pip install requests pillow numpy
    hybrid.py [http://127.0.0.1:8080] [hybrid.png]

Any renderer will do that can give its matrices and its depth buffer: three.js, VTK, Blender.
"""
import io, json, sys
import numpy as np
import requests
from PIL import Image

SERVICE = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:8080"
OUT = sys.argv[2] if len(sys.argv) > 2 else "hybrid.png"
WIDTH, HEIGHT, NEAR, FAR = 512, 512, 50.0, 1000.0


def look_at(eye, target, up):
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    rows = np.stack([right, np.cross(right, forward), -forward])
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = rows, -rows @ eye
    return view


def perspective(fov_y, aspect, near, far):
    f = 1 / np.tan(fov_y / 2)
    return np.array([[f / aspect, 0, 0, 0], [0, f, 0, 0], [0, 0, (far + near) / (near - far), 2 * far * near / (near - far)], [0, 0, -1, 0]])


def torus(radius, tube, n=64, m=32):
    """Vertices and triangles around the z axis."""
    a, b = np.meshgrid(np.arange(n) * 2 * np.pi / n, np.arange(m) * 2 * np.pi / m, indexing="ij")
    ring = radius + tube * np.cos(b)
    vertices = np.stack([ring * np.cos(a), ring * np.sin(a), tube * np.sin(b)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    at = lambda i, j: (i % n) * m + j % m
    quads = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]
    return vertices, np.concatenate([np.stack([quads[k] for k in t], -1).reshape(-1, 3) for t in ((0, 1, 2), (0, 2, 3))])


def rasterize(vertices, triangles, matrix, to_eye):
    """Color (RGB) and depth in window space; the nearest wins."""
    clip = np.c_[vertices, np.ones(len(vertices))] @ matrix.T
    ndc = clip[:, :3] / clip[:, 3:]
    window = np.stack([(ndc[:, 0] + 1) / 2 * WIDTH, (1 - ndc[:, 1]) / 2 * HEIGHT, (ndc[:, 2] + 1) / 2], -1)
    color, depth = np.full((HEIGHT, WIDTH, 3), 24, np.uint8), np.ones((HEIGHT, WIDTH), np.float32)
    for triangle in triangles:
        a, b, c = window[triangle]
        x0, y0 = np.maximum(np.floor(np.minimum(np.minimum(a, b), c)[:2]).astype(int), 0)
        x1, y1 = np.minimum(np.ceil(np.maximum(np.maximum(a, b), c)[:2]).astype(int), [WIDTH, HEIGHT])
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if x0 >= x1 or y0 >= y1 or area == 0:
            continue
        x, y = np.meshgrid(np.arange(x0, x1) + 0.5, np.arange(y0, y1) + 0.5)
        weight = lambda p, q: ((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])) / area
        wa, wb, wc = weight(b, c), weight(c, a), weight(a, b)
        z = wa * a[2] + wb * b[2] + wc * c[2]  # linear in window space
        part = (slice(y0, y1), slice(x0, x1))
        nearest = (wa >= 0) & (wb >= 0) & (wc >= 0) & (z < depth[part])
        normal = np.cross(vertices[triangle[1]] - vertices[triangle[0]], vertices[triangle[2]] - vertices[triangle[0]])
        light = 0.3 + 0.7 * abs(normal @ to_eye) / np.linalg.norm(normal)
        depth[part][nearest] = z[nearest]
        color[part][nearest] = (light * np.array([90, 170, 255])).astype(np.uint8)
    return color, depth


facts = requests.get(f"{SERVICE}/v1/volumes/demo").json()
direction = np.array(facts["direction"]).reshape(3, 3)
extent = (np.array(facts["dimensions"]) - 1) * np.array(facts["spacing"])
centre = np.array(facts["origin"]) + direction @ (extent / 2)
eye = centre + np.array([180.0, -420.0, 150.0])
view, projection = look_at(eye, centre, np.array([0, 0, 1.0])), perspective(np.radians(32), WIDTH / HEIGHT, NEAR, FAR)

vertices, triangles = torus(95, 12)
color, depth = rasterize(vertices + centre, triangles, projection @ view, (eye - centre) / np.linalg.norm(eye - centre))
picture = io.BytesIO()
Image.fromarray(color).save(picture, "PNG")
request = {
    # Column by column, as WebGL has them.
    "camera": {"matrices": {"view": view.T.ravel().tolist(), "projection": projection.T.ravel().tolist()}},
    "image": {"width": WIDTH, "height": HEIGHT, "format": "png"},
    "quality": "high",
}
answer = requests.post(f"{SERVICE}/v1/volumes/demo/frame", files={
    "request": ("request.json", json.dumps(request), "application/json"),
    "depth": ("depth.raw", depth.astype("<f4").tobytes(), "application/octet-stream"),
    "color": ("color.png", picture.getvalue(), "image/png"),
})
if not answer.ok:
    raise SystemExit(answer.json()["detail"])
open(OUT, "wb").write(answer.content)
print(f"{OUT}: {answer.headers['Server-Timing']}")
