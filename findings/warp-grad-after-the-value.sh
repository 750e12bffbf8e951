#!/usr/bin/env bash
# A good guess: `wp.grad(f)` in a kernel of NVIDIA Warp is the gradient of f, whatever else its module does, and as it takes no part in a
# backward pass, that is best left out: Warp warns if it is not. Found: where no kernel has a backward pass and `f` is called for
# its value before, in the kernel or in another one of the module, what f's own functions contribute is left out in silence: the
# gradient of square(x) x is x^2 instead of 3 x^2. Gradient first and value after it, or a backward pass, is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 warp-lang==1.19.0
cat >gradients.py <<'PY'
import numpy as np
import warp as wp

wp.config.kernel_cache_dir = "cache"
wp.config.log_level = wp.LOG_ERROR
Floats = wp.array(dtype=wp.float32)


@wp.func
def square(x: wp.float32):
    return x * x


@wp.func
def cube(x: wp.float32):
    return square(x) * x


def value_then_gradient(x: Floats, value: Floats, slope: Floats):
    i = wp.tid()
    value[i] = cube(x[i])
    slope[i] = wp.grad(cube)(x[i])


def gradient_then_value(x: Floats, value: Floats, slope: Floats):
    i = wp.tid()
    slope[i] = wp.grad(cube)(x[i])
    value[i] = cube(x[i])


x = np.float32([1, 2, 3])
seen = {}
for function in (value_then_gradient, gradient_then_value):
    for backward in (False, True):
        kernel = wp.kernel(function, enable_backward=backward, module="unique")
        value, slope = (wp.zeros(3, dtype=wp.float32, device="cpu") for _ in range(2))
        wp.launch(kernel, 3, inputs=[wp.array(x, device="cpu"), value, slope], device="cpu")
        assert np.array_equal(value.numpy(), x**3), "values: the behaviour has changed"
        seen[function.__name__, backward] = slope.numpy().tolist()
        print("warp-lang", wp.__version__, function.__name__, "backward pass", backward, "gradients", slope.numpy())
right, wrong = (3 * x**2).tolist(), (x**2).tolist()
assert seen.pop(("value_then_gradient", False)) == wrong, "values first: the behaviour has changed"
assert list(seen.values()) == [right] * 3, "the others: the behaviour has changed"
PY
v/bin/python gradients.py
