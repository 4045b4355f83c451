"""What a compiled function can reach: its native code and everything that it calls, read from LLVM."""

import re

import numba

_FUNCTION = re.compile(r'^define [^\n]*?@("?[\w.$]+"?)\(.*?^}', re.MULTILINE | re.DOTALL)
_CALL = re.compile(r'\b(?:call|invoke|tail call|musttail call)\b[^@\n]*?@("?[\w.$]+"?)\(')
_INDIRECT = re.compile(r"\b(?:call|invoke)\b[^@\n]*? %[\w.\"]+\(")
_MATHS = {"sin", "cos", "tan", "exp", "log", "tanh", "atanh", "sqrt", "floor", "ceil", "numba_frexp", "frexp"}
_MEMORY = {"memcpy", "memmove", "memset"}
_CLOCK = {"clock_gettime", "clock_nanosleep"}
# the count of an array's owner, and its release if the count should come to 0: the caller holds it, it does not
_COUNTS = {"NRT_incref", "NRT_decref", "NRT_MemInfo_call_dtor"}
HARMLESS = _MATHS | _MEMORY | _CLOCK | _COUNTS


def llvm_of(function, signature):
    """Optimised LLVM of `function`, a plain one, compiled here and now."""
    fresh = numba.njit(signature, nogil=True, error_model="numpy")(function)
    return fresh.inspect_llvm(fresh.signatures[0])


def llvm_that_runs(function, signature):
    """Optimised LLVM of one of ours, from the cache where it is there: that which the machine code was made of."""
    if signature not in function.overloads:
        function.compile(signature)
    return str(function.overloads[signature].library._get_module_for_linking())  # inspect_llvm knows fresh code only


def reach(llvm, name):
    """Functions inside the native entry's reach, names outside of it, and the number of calls by address.

    The wrappers ``cpython`` (arguments from Python) and ``cfunc`` are not reached from the native entry.
    """
    bodies = {match[1].strip('"'): match[0] for match in _FUNCTION.finditer(llvm)}
    mangled = f"{len(name)}{name}B"
    native = [symbol for symbol in bodies if symbol.startswith("_ZN") and not symbol.startswith("_ZN7cpython")]
    (entry,) = [symbol for symbol in native if mangled in symbol]
    inside, outside, indirect, todo = set(), set(), 0, [entry]
    while todo:
        symbol = todo.pop()
        if symbol in inside:
            continue
        inside.add(symbol)
        indirect += len(_INDIRECT.findall(bodies[symbol])) if symbol not in _COUNTS else 0
        for called in (match.strip('"') for match in _CALL.findall(bodies[symbol])):
            (todo.append if called in bodies else outside.add)(called)
    return inside, {symbol for symbol in outside if not symbol.startswith("llvm.")}, indirect
