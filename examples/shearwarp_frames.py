#!/usr/bin/env python3
"""Frames in Python, in scripts and in Jupyter.

    pip install requests pillow
    shearwarp_frames.py [http://127.0.0.1:8080]

In a notebook:

    from shearwarp_frames import Scan
    scan = Scan("demo")
    scan.frame(azimuth=30)                             # a Pillow image, which Jupyter shows
    scan.show(preset="ct-bone", projection="perspective")
    scan.turn(24)                                      # an animation in the notebook
"""
import io, sys
import requests
from PIL import Image


class Scan:
    """A volume of a running service."""

    def __init__(self, volume, service="http://127.0.0.1:8080"):
        self.url = f"{service}/v1/volumes/{volume}"
        self.session = requests.Session()
        self.timing = {}

    def facts(self):
        """Dimensions, spacing (mm), value range and so on."""
        return self._answer(self.session.get(self.url)).json()

    def frame(self, request=None, **options):
        """A frame as a Pillow image: from a request as the API has it, or from the short names of the frame route
        (azimuth, elevation, zoom, width, height, preset, quality, ...). What it took is in `timing`, in ms by stage."""
        if request is None:
            answer = self.session.get(f"{self.url}/frame.png", params=options)
        else:
            answer = self.session.post(f"{self.url}/frame", json=request, headers={"Accept": "image/png"})
        answer = self._answer(answer)
        stages = (stage.split(";dur=") for stage in answer.headers["Server-Timing"].split(", "))
        self.timing = {name: float(ms) for name, ms in stages}
        return Image.open(io.BytesIO(answer.content))

    def show(self, request=None, **options):
        """Shows a frame in the notebook's cell."""
        from IPython.display import display
        display(self.frame(request, **options))

    def turn(self, frames=36, request=None):
        """A full turn as an animated PNG: shown in a notebook, else its bytes."""
        answer = self._answer(self.session.post(f"{self.url}/turntable", params={"frames": frames}, json=request or {},
                                                headers={"Accept": "image/apng"}))
        try:
            from IPython.display import Image as Animation
            return Animation(data=answer.content, format="png")
        except ImportError:
            return answer.content

    @staticmethod
    def _answer(answer):
        if not answer.ok:
            raise RuntimeError(answer.json()["detail"])
        return answer


if __name__ == "__main__":
    scan = Scan("demo", *sys.argv[1:2])
    print(scan.facts()["dimensions"])
    picture = scan.frame(azimuth=30, width=400, height=300)
    print(picture.size, scan.timing)
    scan.frame({"transfer_function": "ct-bone", "image": {"width": 256, "height": 256}}).save("bone.png")
    try:
        scan.frame(preset="no-such-preset")
    except RuntimeError as refused:
        print(refused)
