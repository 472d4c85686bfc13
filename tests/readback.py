"""Reads back what `metasense export` wrote, with whatever of numpy, pyarrow, ezdxf and trimesh is there."""
import importlib.util, json, os, sys

folder = sys.argv[1]
path = lambda name: os.path.join(folder, name)
have = lambda name: importlib.util.find_spec(name) is not None

if have("numpy"):
    import numpy as np

    z = np.load(path("t.npz"))
    scene = json.loads(str(z["scene"][()]))
    K, M, T = len(scene["panel_units"]), len(scene["sensor_units"]), scene["time"]["samples"]
    N = scene["stimuli"]["samples"] + scene["stimuli"]["holdout"]
    assert z["forces"].shape == (N, K, T + 1) and z["split"].shape == (N,), (z["forces"].shape, z["split"].shape)
    assert np.bincount(z["split"]).tolist() == [15, 5, 5], np.bincount(z["split"])
    brain = scene["brain"]
    kernels = brain.get("kernels", [3, 3, 1])
    dilations = brain.get("dilations", [1] * len(kernels))
    def conv(x, w, b, d):
        reach = (len(w) - 1) * d
        before = reach if brain.get("causal") else reach // 2
        x = np.pad(x, ((0, 0), (before, reach - before), (0, 0)))
        return sum(x[:, k * d : k * d + T] @ w[k] for k in range(len(w))) + b
    for body in ("initial", "optimised"):
        get = lambda name: z[f"{name}_{body}"].astype(float)
        units = scene["body"]["columns"] * scene["body"]["rows"]
        assert get("vertices").shape == (units, 4, 2) and get("signals").shape == (N, T, 3 * M)
        assert get("losses").shape == (1000,) and len(get("alpha")) % 2 == 0
        h = get("signals") / z["signal_scale"]
        for l, d in enumerate(dilations, 1):
            h = conv(h, get(f"w{l}"), get(f"b{l}"), d)
            h = h if l == len(kernels) else np.maximum(h, 0)
        y = z["force_mean"] + z["force_std"] * h
        worst = abs(y - get("predictions")).max() / abs(y).max()
        assert worst < 1e-4, f"the network evaluated by numpy differs by {worst}"
    train = z["signals_initial"][z["split"] == 0]
    rms = np.sqrt((train ** 2).mean((0, 1)))
    assert np.allclose(rms, z["signal_scale"], rtol=1e-6), (rms, z["signal_scale"])
    np.savez_compressed(path("packed.npz"), **z)
    print("numpy")

if have("pyarrow"):
    import pyarrow.parquet as pq

    t = pq.read_table(path("t.parquet"))
    assert t.num_rows == N * T and t.schema.field("time").type == "double", t.schema
    assert t["set"].to_pylist()[0] in ("train", "test") and t["set"].to_pylist()[-1] == "holdout"
    assert abs(t["force_0"].to_numpy().reshape(N, T) - z["forces"][:, 0, 1:]).max() == 0
    v = pq.read_table(path("v.parquet"))
    states = v["state"].to_pylist()
    assert v["reason"].null_count == len(states) - states.count("failed"), v["reason"].null_count
    n = pq.ParquetFile(path("many.parquet"))
    assert n.num_row_groups == 2 and [c.physical_type for c in n.schema] == ["INT64", "DOUBLE", "BYTE_ARRAY", "INT32"], n.schema
    n = n.read()
    assert n["i"].to_pylist() == list(range(1, 70001)) and n["half"].to_pylist()[-1] == 35000
    assert n["either"].to_pylist()[-2:] == ["69999", "much"] and n["none"].null_count == 70000
    print("pyarrow")

if have("ezdxf"):
    import ezdxf

    doc = ezdxf.readfile(path("t.dxf"))
    count = {}
    for e in doc.modelspace().query("POLYLINE"):
        assert e.is_closed
        count[e.dxf.layer] = count.get(e.dxf.layer, 0) + 1
    assert not doc.audit().errors
    columns, rows = scene["body"]["columns"], scene["body"]["rows"]
    ligaments = (columns - 1) * rows + columns * (rows - 1)
    assert count == {"units": columns * rows, "ligaments": ligaments, "panels": K, "sensors": M, "notes": 1}, count
    print("ezdxf")

if have("trimesh"):
    import trimesh

    mesh = trimesh.load(path("t.stl"))
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0, mesh
    assert abs(mesh.extents[2] - 13.0) < 1e-5, mesh.extents
    print("trimesh")
