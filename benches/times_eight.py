#!/usr/bin/env python3
"""Makes the large city of the figures: a GeoJSON city eight times side by side (4 x 2), every building jittered.

    python3 benches/times_eight.py tokyo_setagaya.geojson.gz big.geojson.gz

One feature a line in and out. Each copy is moved by the city's own width or height plus 50 m, each building by up to
2 cm (seeded by copy and row: the same file every time), and its id gets the copy's number.
"""
import gzip
import json
import random
import sys

source, target = sys.argv[1:]
features = []
with gzip.open(source, "rt") as lines:
    for line in lines:
        line = line.strip().rstrip(",")
        if line.startswith('{"type":"Feature",'):
            features.append(json.loads(line.removesuffix("]}") if line.endswith("]}]}") else line))


def rings(geometry):
    parts = geometry["coordinates"]
    return parts if geometry["type"] == "Polygon" else [ring for part in parts for ring in part]


points = [p for f in features for ring in rings(f["geometry"]) for p in ring]
west, east = min(p[0] for p in points), max(p[0] for p in points)
south, north = min(p[1] for p in points), max(p[1] for p in points)
step = (east - west + 0.0005, north - south + 0.0005)
with gzip.open(target, "wt", compresslevel=5) as out:
    out.write('{"type":"FeatureCollection","name":"times-eight","features":[\n')
    for copy in range(8):
        dice = random.Random(copy)
        for row, feature in enumerate(features):
            dx = step[0] * (copy % 4) + dice.uniform(-2e-7, 2e-7)
            dy = step[1] * (copy // 4) + dice.uniform(-2e-7, 2e-7)
            moved = json.loads(json.dumps(feature))
            for ring in rings(moved["geometry"]):
                for p in ring:
                    p[0], p[1] = round(p[0] + dx, 7), round(p[1] + dy, 7)
            if "id" in moved["properties"]:
                moved["properties"]["id"] = f'{moved["properties"]["id"]}-{copy}'
            last = copy == 7 and row == len(features) - 1
            out.write(json.dumps(moved, separators=(",", ":")) + ("\n" if last else ",\n"))
    out.write("]}\n")
print(f"{8 * len(features)} features")
