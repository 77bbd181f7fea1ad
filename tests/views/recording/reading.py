"""Recordings read back."""

import numpy as np
from rerun.chunk import RrdReader

FLOAT32 = 2e-6  # relative rounding of what Rerun stores


def read(path, entity, component, timeline="sim_time"):
    """Times [N] (s, or whole numbers) and rows of a component as lists, in the order of time."""
    stream = RrdReader(path).stream()
    chunks = stream.filter(content=entity, components=component, is_static=False).to_chunks()
    times, rows = [], []
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if timeline not in batch.schema.names:
            continue
        column = batch.column(timeline)
        times += [t.value * 1e-9 if timeline == "sim_time" else t.as_py() for t in column]
        rows += batch.column(component).to_pylist()
    order = np.argsort(times, kind="stable")
    return np.array(times)[order], [rows[i] for i in order]


def scalars(path, entity, timeline="sim_time"):
    t, rows = read(path, entity, "Scalars:scalars", timeline)
    return t, np.array([row[0] for row in rows])


def poses(path, entity):
    t, places = read(path, entity, "Transform3D:translation")
    return t, np.array(places)[:, 0]


def static(path, entity, component):
    stream = RrdReader(path).stream()
    (chunk,) = stream.filter(content=entity, components=component, is_static=True).to_chunks()
    return chunk.to_record_batch().column(component).to_pylist()[0]


def rotations(quaternions):
    """Rotation matrices [N,3,3] of quaternions [N,4] (x, y, z, w)."""
    x, y, z, w = np.asarray(quaternions, dtype=float).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)
