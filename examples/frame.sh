#!/bin/sh
# Frames by curl.   frame.sh [http://127.0.0.1:8080]
set -eu
service=${1:-http://127.0.0.1:8080}

# A frame by URL, as an <img> would ask for it.
curl -sf -o azimuth-30.png "$service/v1/volumes/demo/frame.png?azimuth=30&width=512&height=512"

# Any request as JSON; the answer tells what each stage took.
curl -sf -o bone.png -D headers.txt -H 'Content-Type: application/json' "$service/v1/volumes/demo/frame" -d '{
  "camera": {"projection": "perspective", "azimuth": 30, "elevation": 15},
  "image": {"width": 512, "height": 512, "background": "transparent"},
  "transfer_function": "ct-bone",
  "quality": "high"
}'
grep -i '^server-timing' headers.txt

# A turn of 12 frames as an animated PNG.
curl -sf -o turn.apng -H 'Content-Type: application/json' -H 'Accept: image/apng' "$service/v1/volumes/demo/turntable?frames=12" \
  -d '{"image": {"width": 256, "height": 256}, "quality": "draft"}'

# A request that cannot be served says which field is at fault (curl's -f is left out to see it).
curl -s -H 'Content-Type: application/json' "$service/v1/volumes/demo/frame" -d '{"camera": {"azimut": 30}}'
echo
