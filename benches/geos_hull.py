#!/usr/bin/env python3
"""Simplifies one large ring with GEOS (PolygonHullSimplify, outer, vertex fraction) and with lodge, side by side.

    LODGE_DATA=.. LODGE_RINGS=. cargo bench --bench hulls -- tokyo_centre
    python3 benches/geos_hull.py tokyo_centre.csv target/release/deps/hulls-<hash> 30 100 1000 10000

GEOS is the one that shapely's wheel bundles (3.14 in shapely 2.2), called through its C interface. It often stops a
vertex short of its fraction, so lodge is given the number of vertices that GEOS came to. Seconds: best of three.
"""
import ctypes
import glob
import os
import subprocess
import sys
import time

try:
    import shapely
except ImportError:
    sys.exit("skipped: no shapely, so no GEOS")

folder = os.path.dirname(os.path.dirname(shapely.__file__))
found = glob.glob(os.path.join(folder, "shapely.libs", "libgeos_c*"))
if not found:
    sys.exit("skipped: this shapely bundles no GEOS")
geos = ctypes.CDLL(found[0])
pointer, number, double = ctypes.c_void_p, ctypes.c_uint, ctypes.c_double


def function(name, result, *arguments):
    out = getattr(geos, name)
    out.restype, out.argtypes = result, arguments
    return out


handle = function("GEOS_init_r", pointer)()
sequence = function("GEOSCoordSeq_copyFromBuffer_r", pointer, pointer, pointer, number, ctypes.c_int, ctypes.c_int)
linear_ring = function("GEOSGeom_createLinearRing_r", pointer, pointer, pointer)
polygon = function("GEOSGeom_createPolygon_r", pointer, pointer, pointer, pointer, number)
simplify = function("GEOSPolygonHullSimplify_r", pointer, pointer, pointer, number, double)
area_of = function("GEOSArea_r", ctypes.c_int, pointer, pointer, ctypes.POINTER(double))
count_of = function("GEOSGetNumCoordinates_r", ctypes.c_int, pointer, pointer)
destroy = function("GEOSGeom_destroy_r", None, pointer, pointer)

path, bench, *counts = sys.argv[1:]
points = [tuple(map(float, line.split(","))) for line in open(path)]
points.append(points[0])
flat = (double * (2 * len(points)))(*[c for p in points for c in p])
plan = polygon(handle, linear_ring(handle, sequence(handle, flat, len(points), 0, 0)), None, 0)
n = len(points) - 1
print(f"{path}: {n} vertices, GEOS {shapely.geos_version_string}")
for wanted in map(int, counts):
    best = float("inf")
    for _ in range(3):
        start = time.perf_counter()
        hull = simplify(handle, plan, 1, wanted / n)
        best = min(best, time.perf_counter() - start)
        area = double()
        area_of(handle, hull, ctypes.byref(area))
        vertices = count_of(handle, hull) - 1
        destroy(handle, hull)
    theirs = area.value / 1e6
    line = subprocess.run([bench, "--ring", path, str(vertices)], capture_output=True, text=True, check=True).stdout
    ours_vertices, ours, one, two = map(float, line.split(","))
    print(
        f"  {vertices} vertices: GEOS {best:.3f} s, {theirs:.3f} m2; lodge ({ours_vertices:.0f}) {one:.3f} s on one thread "
        f"({best / one:.1f} x), {two:.3f} s on two ({best / two:.1f} x), area {ours / theirs - 1:+.1e}"
    )
