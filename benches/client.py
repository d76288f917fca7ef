#!/usr/bin/env python3
"""What a 3D Tiles client loads and draws of a tileset on disk.

client.py FOLDER.. [--km 2 5 20] [--error 16] [--rows 1080] [--fov 60] [--aspect 1.7778]

The camera looks at the middle of the city from so many kilometres, 45 degrees down, to the north. A client draws a
tile when its geometric error is at most `error` pixels at the distance of its box, else its children (REPLACE); boxes
outside the view are left out. To get there it loads the tiles above as well: `loaded` counts them. `leaf-only` is the
same city with empty inner tiles, where every leaf in view has to be drawn.
"""
import argparse
import functools
import json
import math
import os
import struct


def times(a, b):
    return [sum(a[i % 4 + 4 * k] * b[i // 4 * 4 + k] for k in range(4)) for i in range(16)]


def apply(m, p):
    return [m[k] * p[0] + m[4 + k] * p[1] + m[8 + k] * p[2] + m[12 + k] for k in range(3)]


def turn(m, v):
    return [m[k] * v[0] + m[4 + k] * v[1] + m[8 + k] * v[2] for k in range(3)]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


class City:
    """A tileset in the axes of its root: every tile with its box, error, triangles and bytes."""

    def __init__(self, folder):
        self.folder = folder
        with open(os.path.join(folder, "tileset.json"), encoding="utf-8") as file:
            self.tileset = json.load(file)
        self.root = self.tile(self.tileset["root"], IDENTITY, True)

    def tile(self, tile, above, root=False):
        # The root's way to the globe is the same for all: everything stays in its axes.
        m = above if root else times(above, tile.get("transform", IDENTITY))
        b = tile["boundingVolume"]["box"]
        out = {
            "middle": apply(m, b[:3]),
            "axes": [turn(m, b[k:k + 3]) for k in (3, 6, 9)],
            "error": tile["geometricError"],
        }
        uri = tile.get("content", {}).get("uri")
        out["triangles"], out["bytes"] = self.content(uri) if uri else (0, 0)
        out["children"] = [self.tile(c, m) for c in tile.get("children", [])]
        return out

    @functools.lru_cache(maxsize=None)
    def content(self, uri):
        path = os.path.join(self.folder, uri)
        with open(path, "rb") as file:
            head = file.read(20)
            gltf = json.loads(file.read(struct.unpack_from("<I", head, 12)[0]))
        parts = (p for m in gltf.get("meshes", []) for p in m["primitives"])
        return sum(gltf["accessors"][p["indices"]]["count"] // 3 for p in parts), os.path.getsize(path)


class Camera:
    def __init__(self, target, distance, fov, aspect, rows):
        s = math.sqrt(0.5)
        self.at = [target[0], target[1] - s * distance, target[2] + s * distance]
        self.pixels = rows / (2 * math.tan(math.radians(fov) / 2))
        forward, right, up = [0, s, -s], [1, 0, 0], [0, s, s]
        v = math.tan(math.radians(fov) / 2)
        h = v * aspect
        self.planes = [forward] + [
            [f * size + sign * a for f, a in zip(forward, axis)]
            for axis, size in ((right, h), (up, v)) for sign in (1, -1)
        ]

    def sees(self, tile):
        d = [a - b for a, b in zip(tile["middle"], self.at)]
        return all(dot(n, d) + sum(abs(dot(n, a)) for a in tile["axes"]) >= 0 for n in self.planes)

    def distance(self, tile):
        d = [a - b for a, b in zip(self.at, tile["middle"])]
        out = 0.0
        for axis in tile["axes"]:
            size = math.sqrt(dot(axis, axis))
            out += max(0.0, abs(dot(axis, d)) / size - size) ** 2
        return math.sqrt(out)

    def error(self, tile):
        return tile["error"] * self.pixels / max(self.distance(tile), 1e-9)


def view(tile, camera, most, drawn, loaded, leaves):
    """Sorts what is in view into what is drawn, what is loaded to get there, and the leaves that are in view."""
    if not camera.sees(tile):
        return
    refine = tile["children"] and camera.error(tile) > most
    if drawn is not None:
        loaded.append(tile)
        if not refine:
            drawn.append(tile)
    if not tile["children"]:
        leaves.append(tile)
    for child in tile["children"]:
        # Below what is drawn only leaves are looked for.
        view(child, camera, most, drawn if refine else None, loaded, leaves)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folders", nargs="+")
    parser.add_argument("--km", type=float, nargs="*", default=[2, 5, 20])
    parser.add_argument("--error", type=float, default=16)
    parser.add_argument("--rows", type=float, default=1080)
    parser.add_argument("--fov", type=float, default=60)
    parser.add_argument("--aspect", type=float, default=16 / 9)
    args = parser.parse_args()
    for folder in args.folders:
        city = City(folder)
        root = city.root
        ground = [root["middle"][0], root["middle"][1], root["middle"][2] - root["axes"][2][2]]
        print(f"{folder}\n{'km':>4} {'':10} {'tiles':>7} {'triangles':>11} {'MB':>8}")
        for km in args.km:
            camera = Camera(ground, 1000 * km, args.fov, args.aspect, args.rows)
            drawn, loaded, leaves = [], [], []
            view(root, camera, args.error, drawn, loaded, leaves)
            for name, tiles in (("drawn", drawn), ("loaded", loaded), ("leaf-only", leaves)):
                triangles, size = sum(t["triangles"] for t in tiles), sum(t["bytes"] for t in tiles)
                print(f"{km:4g} {name:10} {len(tiles):7} {triangles:11} {size / 1e6:8.2f}")
        for level in city.tileset.get("extras", {}).get("levels", []):
            keys = ("depth", "tiles", "features", "triangles", "error_max", "lost", "closed")
            print("     " + " ".join(f"{k} {level.get(k, 0):.6g}" for k in keys))


main()
