# SPDX-License-Identifier: GPL-3.0-or-later
"""How kernels are written, checked on their source: typed parameters, outputs marked and last, no defaults.

One rule is about correctness: Warp's atomics are not atomic between threads on the processor, so no kernel that uses
one may be launched in bands (engine/device.py runs those on several threads).
"""

from __future__ import annotations

import ast
import functools
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MAX_KERNEL_LINES = 80
RUN_BANDS = "run_bands"
"""The function in engine/device.py that runs launches side by side."""


parse = functools.cache(ast.parse)
"""Several tests read all files"""


def decorator_name(node: ast.FunctionDef) -> str:
    """Return `kernel` or `func` for functions decorated for Warp, else an empty string."""
    for decorator in node.decorator_list:
        target = decorator.func if isinstance(decorator, ast.Call) else decorator
        if isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name) and target.value.id == "wp":
            return target.attr if target.attr in ("kernel", "func") else ""
    return ""


def warp_functions(tree: ast.AST) -> list[ast.FunctionDef]:
    """Return all kernels and Warp functions in a module."""
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and decorator_name(node)]


def base_name(node: ast.expr) -> str | None:
    """Return the variable that an element or field belongs to: `frame_out` of `frame_out.radiance[i, j]`."""
    while isinstance(node, ast.Subscript | ast.Attribute):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None


def called_name(node: ast.Call) -> str:
    """Return the name of what is called, without the module or object before it."""
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def is_atomic(node: ast.AST) -> bool:
    """Tell whether a node is a call of one of Warp's atomics."""
    return isinstance(node, ast.Call) and called_name(node).startswith("atomic_")


def written_names(function: ast.FunctionDef) -> set[str]:
    """Return the variables into whose elements or fields a function writes."""
    names = set()
    for node in ast.walk(function):
        targets = []
        if isinstance(node, ast.Assign):
            targets = [leaf for target in node.targets for leaf in
                       (target.elts if isinstance(target, ast.Tuple) else [target])]
        elif isinstance(node, ast.AugAssign):
            targets = [node.target]
        elif is_atomic(node) and node.args:
            names.add(base_name(node.args[0]))
        names |= {base_name(target) for target in targets if isinstance(target, ast.Subscript | ast.Attribute)}
    return names


def signature_errors(function: ast.FunctionDef) -> list[str]:
    """Return what is wrong with a kernel's or Warp function's parameters in themselves."""
    name, arguments = function.name, function.args
    errors = [f"{name}: parameter {argument.arg} has no type" for argument in arguments.args
              if argument.annotation is None]
    if arguments.vararg or arguments.kwarg or arguments.kwonlyargs:
        errors.append(f"{name} has variable or keyword-only parameters")
    if arguments.defaults:
        errors.append(f"{name} has default values")
    return errors


def kernel_errors(function: ast.FunctionDef, lines: list[str]) -> list[str]:
    """Return what is wrong with a kernel: its outputs and its length."""
    name = function.name
    parameters = [argument.arg for argument in function.args.args]
    outputs = [parameter for parameter in parameters if parameter.endswith("_out")]
    errors = []
    if not outputs:
        errors.append(f"{name} has no output: what it writes ends in _out")
    elif parameters[-len(outputs):] != outputs:
        errors.append(f"{name}: outputs must come last")
    else:
        first = next(argument for argument in function.args.args if argument.arg == outputs[0])
        above = [line.strip() for line in lines[function.lineno - 1:first.lineno - 1]]
        if not any(line.startswith("# Out:") for line in above):
            errors.append(f"{name}: the comment `# Out:` must stand before {outputs[0]}")
    wrong = (written_names(function) & set(parameters)) - set(outputs)
    errors += [f"{name} writes to {parameter}, which is no output" for parameter in sorted(wrong)]
    length = function.end_lineno - function.lineno + 1
    if length > MAX_KERNEL_LINES:
        errors.append(f"{name} has {length} lines, more than {MAX_KERNEL_LINES}")
    return errors


def module_errors(source: str) -> list[str]:
    """Return all style errors of one file in kernels/."""
    tree, lines = parse(source), source.splitlines()
    functions = warp_functions(tree)
    kernels = [function for function in functions if decorator_name(function) == "kernel"]
    errors = [error for function in functions for error in signature_errors(function)]
    errors += [error for kernel in kernels for error in kernel_errors(kernel, lines)]
    errors += [f"{function.name} is nested" for function in functions if function not in tree.body]
    errors += [f"{function.name} takes the bits of a half-float: pack_pair and pack_halves do"
               for function in functions if any(map(takes_half_bits, ast.walk(function)))]
    if kernels and not {("enable_backward", False), ("default_grid_stride", False)} <= module_options(tree):
        errors.append("the file owns kernels and must set enable_backward and default_grid_stride to False")
    return errors


def takes_half_bits(node: ast.AST) -> bool:
    """Return whether an expression is wp.cast(..., wp.uint16): from packing such by shifts rubbish may come on CUDA."""
    return isinstance(node, ast.Call) and called_name(node) == "cast" and ast.unparse(node.args[-1]) == "wp.uint16"


def module_options(tree: ast.Module) -> set[tuple[str, object]]:
    """Return the options that a module passes to wp.set_module_options."""
    options = set()
    for node in tree.body:
        call = node.value if isinstance(node, ast.Expr) else None
        if isinstance(call, ast.Call) and called_name(call) == "set_module_options":
            options |= set(ast.literal_eval(call.args[0]).items())
    return options


def atomic_kernels(sources: list[str]) -> set[str]:
    """Return the names of all kernels that use an atomic, themselves or in a function that they call."""
    functions = {function.name: function for source in sources for function in warp_functions(parse(source))}
    calls = {name: {called_name(node) for node in ast.walk(function) if isinstance(node, ast.Call)}
             for name, function in functions.items()}
    atomic = {name for name, function in functions.items() if any(map(is_atomic, ast.walk(function)))}
    while more := {name for name, called in calls.items() if called & atomic} - atomic:
        atomic |= more
    return {name for name in atomic if decorator_name(functions[name]) == "kernel"}


def names_in(node: ast.AST) -> set[str]:
    """Return all variables and attributes that a node mentions."""
    return {leaf.attr if isinstance(leaf, ast.Attribute) else leaf.id
            for leaf in ast.walk(node) if isinstance(leaf, ast.Attribute | ast.Name)}


def names_in_bands(sources: list[str]) -> set[str]:
    """Return every name that may be a kernel launched in bands.

    Those are all names in functions that call run_bands; where such a function takes a parameter `kernel`, it is a
    launcher itself, and the names in its callers' arguments count instead.
    """
    trees = [parse(source) for source in sources]
    functions = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    calls = {function: [node for node in ast.walk(function) if isinstance(node, ast.Call)] for function in functions}
    launchers = {RUN_BANDS}
    takes_kernel = [function for function in functions
                    if any(argument.arg == "kernel" for argument in function.args.args + function.args.kwonlyargs)]
    while more := {function.name for function in takes_kernel
                   if any(called_name(call) in launchers for call in calls[function])} - launchers:
        launchers |= more
    names = set()
    for function in functions:
        for call in calls[function]:
            if called_name(call) == RUN_BANDS and function not in takes_kernel:
                names |= names_in(function)
            elif called_name(call) in launchers - {RUN_BANDS}:
                names |= {name for argument in [*call.args, *call.keywords] for name in names_in(argument)}
    return names


def read_all(folder: str) -> dict[str, str]:
    """Return the source of every file in a folder of the package, by its path below the root."""
    paths = sorted((ROOT / folder).rglob("*.py"))
    return {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in paths}


def test_kernels_keep_the_style() -> None:
    """Check every file in kernels/."""
    errors = [f"{path}: {error}" for path, source in read_all("kernels").items() for error in module_errors(source)]
    assert not errors, "\n".join(errors)


def test_no_atomic_runs_in_bands() -> None:
    """Launch kernels with atomics in one piece."""
    atomic = atomic_kernels(list(read_all("kernels").values()))
    wrong = atomic & names_in_bands(list(read_all("engine").values()))
    assert not wrong, f"kernels with atomics may be launched in bands: {', '.join(sorted(wrong))}"


def test_tests_of_kernels_follow_the_device() -> None:
    """Run what `pytest --device` is given: a compiler's fault on one device shows on that device alone."""
    wrong = [path for path, source in read_all("tests/unit/kernels").items() if 'device="cpu"' in source]
    assert not wrong, f"these launch kernels on the processor whatever --device says: {', '.join(wrong)}"


GOOD = """
import warp as wp
wp.set_module_options({"enable_backward": False, "default_grid_stride": False})
@wp.func
def twice(x: float):
    return x + x
@wp.kernel
def double(
    # In:
    values: wp.array[float],
    # Out:
    values_out: wp.array[float],
):
    i = wp.tid()
    values_out[i] = twice(values[i])
"""


@pytest.mark.parametrize(("old", "new", "expected"), [
    ("values: wp.array[float],", "values,", "double: parameter values has no type"),
    ("x: float", "x: float = 1.0", "twice has default values"),
    ("    # Out:\n", "", "double: the comment `# Out:` must stand before values_out"),
    ("values_out[i] =", "values_out[i] = values[i]\n    values[i] =", "double writes to values, which is no output"),
    ("values_out[i] = twice(values[i])", "wp.atomic_add(values, i, 1.0)",
     "double writes to values, which is no output"),
    ("values_out", "values_new", "double has no output: what it writes ends in _out"),
    ("    values_out: wp.array[float],\n", "    values_out: wp.array[float],\n    n: int,\n",
     "double: outputs must come last"),
    ("wp.set_module_options", "print",
     "the file owns kernels and must set enable_backward and default_grid_stride to False"),
    ("return x + x", "return float(wp.uint32(wp.cast(wp.float16(x), wp.uint16)))",
     "twice takes the bits of a half-float: pack_pair and pack_halves do"),
    ("    i = wp.tid()\n", "    i = wp.tid()\n" * 80, "double has 87 lines, more than 80"),
])
def test_bad_style_is_found(old: str, new: str, expected: str) -> None:
    """Find each kind of error once it is put into a good file."""
    assert module_errors(GOOD) == []
    assert old in GOOD
    assert expected in module_errors(GOOD.replace(old, new))


def test_atomics_are_found() -> None:
    """See an atomic through the functions that a kernel calls."""
    source = GOOD.replace("return x + x", "wp.atomic_add(counter, 0, 1)")
    assert atomic_kernels([GOOD]) == set()
    assert atomic_kernels([source]) == {"double"}


def test_band_launches_are_found() -> None:
    """See kernels launched in bands directly and through a launcher, and no others."""
    direct = "def f(self):\n    device.run_bands([lambda: wp.launch(scan.double, 4)])\n"
    launcher = "def launch_rows(kernel, rows):\n    run_bands([partial(wp.launch, kernel, row) for row in rows])\n"
    caller = "def f(self):\n    launch_rows(scan.double, 4)\n    wp.launch(scan.count, 4)\n"
    assert "double" in names_in_bands([direct])
    assert "double" in names_in_bands([launcher, caller])
    assert "count" not in names_in_bands([launcher, caller])
    assert names_in_bands([launcher]) == set()
