"""Whether ONNX Runtime says of t.onnx in a folder what t.npz has as the optimised body's predictions."""
import json, pathlib, sys

import numpy as np
import onnxruntime

folder = pathlib.Path(sys.argv[1])
trial = np.load(folder / "t.npz")
session = onnxruntime.InferenceSession(folder / "t.onnx", providers=["CPUExecutionProvider"])
assert [x.name for x in session.get_inputs() + session.get_outputs()] == ["signals", "forces"]
told = session.get_modelmeta().custom_metadata_map
assert told["body"] == "optimised" and float(told["interval"]) > 0, told
known = trial["predictions_optimised"]
said = session.run(None, {"signals": trial["signals_optimised"].astype(np.float32)})[0]
# what a stacked brain says of training samples, it says on linear brains that had not seen them
alike = trial["split"] > (0 if json.loads(str(trial["scene"][()]))["brain"].get("kind") == "stacked" else -1)
worst = abs(said - known)[alike].max() / abs(known).max()
assert said.shape == known.shape and worst < 1e-4, f"ONNX Runtime differs by {worst}"
# fewer samples, and one that ends sooner
part = session.run(None, {"signals": trial["signals_optimised"][:1, :9].astype(np.float32)})[0]
assert part.shape == (1, 9, known.shape[2])
