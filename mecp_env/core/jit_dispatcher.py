"""numba's dispatcher, but a function that only compiled functions call gets neither wrapper nor machine code.

It is part of its callers' machine code. numba would make both for each of them, a third of the time of a first start.
When Python calls such a function after all, it is compiled again, with both.

Beside that, an array that a compiled function returns costs a third of what numba makes of it (`box_array`).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from numba.core.boxing import box_array as numba_box_array
from numba.core.codegen import JITCodeLibrary
from numba.core.pythonapi import _boxers
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
from numba.core.types import Array
from numba.core.types.misc import unliteral

from mecp_env.core.interrupts import interrupts_later
from mecp_env.core.jit_cache import within_another_compilation
from mecp_env.core.warm_up_list import called_from_python


def box_array(kind: Any, value: Any, context: Any) -> Any:
    """As numba's own, but the class of the result is a constant: numba asks for it, pickled, in every call (0.25 us).

    Where another numba makes its arrays in another way, it does so here.
    """
    api, constants = context.pyapi, context.env_manager
    array_class = constants.read_const(constants.add_const(kind.box_type))
    api.serialize_object, api.unserialize = lambda class_: class_, lambda _: array_class
    try:
        return numba_box_array(kind, value, context)
    finally:
        del api.serialize_object, api.unserialize  # the methods behind them


_boxers.functions[Array] = box_array


class _InnerLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Optimised intermediate code, which callers link in."""

    def _finalize_final_module(self) -> None:
        self._finalized = True


class LeanDispatcher(CPUDispatcher):  # type: ignore[misc]
    """Compiles a function for Python, or as a part of the function that is being compiled."""

    def __init__(self, function: Callable[..., Any], targetoptions: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=targetoptions | {"nopython": True})
        self._inner = False
        self._compiler._customize_flags = self._with_choice

    def compile(self, sig: Any) -> Any:
        """The entry point for the argument types `sig`."""
        outer = self._inner
        self._inner = within_another_compilation(sys._getframe()) and not called_from_python(self.py_func)
        arguments = tuple(normalize_signature(sig)[0])
        if not self._inner and isinstance(getattr(self.overloads.get(arguments), "library", None), _InnerLibrary):
            del self.overloads[arguments]
        try:
            with interrupts_later():  # LLVM's bindings would lose one, or end the process
                return super().compile(sig)
        finally:
            self._inner = outer

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """The signature of a call; a number written in it makes no variant of its own."""
        return super().get_call_template(tuple(map(unliteral, args)), {name: unliteral(kws[name]) for name in kws})

    def _with_choice(self, flags: Any) -> Any:
        flags.no_compile = flags.no_cpython_wrapper = self._inner
        return flags

    def add_overload(self, cres: Any) -> None:
        """Register what was compiled or loaded: for calls from Python, or for callers that link it in."""
        if cres.entry_point is not None:
            super().add_overload(cres)
            for environment in cres._find_referenced_environments():  # of inner functions that raise
                cres.codegen.set_env(environment.env_name, environment)
            return
        cres.library.__class__ = _InnerLibrary
        cres = cres._replace(entry_point=object())  # its name among the functions that callers know
        self.targetctx.insert_user_function(cres.entry_point, cres.fndesc, [cres.library])
        self.overloads[tuple(cres.signature.args)] = cres
