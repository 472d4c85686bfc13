"""A Tesseract as a body: forwards each call to its HTTP server.

    TESSERACT_API_PATH=tesseract_api.py tesseract-runtime serve --port 8000
    command = ["python3", "tesseract.py", "http://127.0.0.1:8000"]

Its inputs are Float64 arrays: alpha (D,), differentiable; forces (N, P, R + 1); times (T,). Its output is signals (N, T, S, C),
differentiable. Its endpoints are apply and vector_jacobian_product. The trial's hash covers the version that it states.
"""

import base64
import json
import sys
import urllib.error
import urllib.request

import metasense
import numpy as np

URL = sys.argv[1]
# what a Tesseract does not describe: adapt it to yours
BODY = {"alpha0": np.full(49, 4.0), "lower": 2.0, "upper": 8.0, "panels": ["a", "b", "c", "d"], "channels": ["acceleration"]}
SENSORS = [str(place) for place in range(49)]


def ask(endpoint, payload=None):
    headers = {"Content-Type": "application/json", "Accept": "application/json+base64"}
    request = urllib.request.Request(f"{URL}/{endpoint}", payload and json.dumps(payload).encode(), headers)
    try:
        with urllib.request.urlopen(request) as answer:
            return json.load(answer)
    except urllib.error.HTTPError as error:
        raise ValueError(error.read().decode()[:1000]) from error
    except OSError as error:
        sys.exit(f"no Tesseract at {URL}: {error}")  # metasense starts this program again


def packed(values):
    buffer = base64.b64encode(np.ascontiguousarray(values, dtype="<f8")).decode()
    data = {"buffer": buffer, "encoding": "base64"}
    return {"object_type": "array", "shape": np.shape(values), "dtype": "float64", "data": data}


def unpacked(answer):
    return np.frombuffer(base64.b64decode(answer["data"]["buffer"]), answer["dtype"]).reshape(answer["shape"])


def inputs(alpha, forces, times):
    return {"alpha": packed(alpha), "forces": packed(forces), "times": packed(times)}


def simulate(*given):
    return unpacked(ask("apply", {"inputs": inputs(*given)})["signals"])


def vjp(*given):
    *given, cotangent = given
    wanted = {"vjp_inputs": ["alpha"], "vjp_outputs": ["signals"], "cotangent_vector": {"signals": packed(cotangent)}}
    return unpacked(ask("vector_jacobian_product", {"inputs": inputs(*given), **wanted})["alpha"])


info = ask("openapi.json")["info"]
metasense.serve_body(
    simulate, name=info["title"], version=info["version"], sensors=SENSORS, vjp=vjp, batched=True, batch=1000, **BODY
)
