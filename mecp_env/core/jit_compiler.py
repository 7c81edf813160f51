"""How kernels are compiled: one that only other kernels call gets no machine code of its own.

numba optimises every function that it compiles, wraps it for Python and for C, turns it into machine code, and then
links it into its callers, where it is optimised and turned into machine code again. Three of four kernels here are
never called from Python, so this was half of the first start. An inner kernel is therefore left as intermediate code
until the kernel that Python called is finished; called from Python later, it is compiled again, in full. What kernels
compute stays the same to the bit: LLVM may not reorder floating-point operations, whenever it optimises.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, _LowerResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
from numba.core.typed_passes import NativeLowering
from numba.core.types.misc import unliteral

from mecp_env.core.jit_cache import Inner

_compiling: list[Kernel] = []  # outermost first; numba's compiler lock guards it
_environments: list[Any] = []  # of kernels linked into others: machine code points to them for ever


class Kernel(CPUDispatcher):  # type: ignore[misc]
    """A compiled function, in full once Python calls it."""

    def compile(self, sig: Any) -> Any:
        """The entry point for the argument types `sig`: from memory, from the cache, or compiled."""
        with global_compiler_lock:
            if not _compiling:
                self._forget_inner(tuple(normalize_signature(sig)[0]))
            _compiling.append(self)
            try:
                return super().compile(sig)
            finally:
                _compiling.pop()

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """What a kernel that calls this one must know: one compilation for all constants as arguments, not one each."""
        named = {name: unliteral(kind) for name, kind in dict(kws).items()}
        return super().get_call_template(tuple(map(unliteral, args)), named)

    def add_overload(self, cres: Any) -> None:
        """Keep a compilation; one without machine code is kept from calls by Python."""
        if isinstance(cres.entry_point, Inner):
            self.overloads[tuple(cres.signature.args)] = cres
            return
        for environment in cres._find_referenced_environments():
            cres.library.codegen.set_env(environment.env_name, environment)
            _environments.append(environment)
        super().add_overload(cres)

    def _forget_inner(self, arguments: tuple[Any, ...]) -> None:
        known = self.overloads.get(arguments)
        if known is not None and isinstance(known.entry_point, Inner):
            del self.overloads[arguments]


class _InnerLibrary(JITCodeLibrary):  # type: ignore[misc]
    """The code of an inner kernel: linked with what it calls, optimised function by function, not made executable.

    Without that much its loops would take up to half as long again.
    """

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):  # type: ignore[misc]
    """numba's step to intermediate code, which here is the last one for an inner kernel."""

    _name = "mecp_env_lowering"

    def run_pass(self, state: Any) -> bool:
        inner = len(_compiling) > 1
        if inner:
            state.library = _InnerLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
            state.flags.no_cpython_wrapper = state.flags.no_cfunc_wrapper = state.flags.no_compile = True
        super().run_pass(state)
        if inner:
            state.cr = _offer(state)
        return True


def _offer(state: Any) -> Any:
    """Let other kernels call an inner kernel: the place of its machine code is taken by a token."""
    made, token = state.cr, Inner()
    state.targetctx.insert_user_function(token, made.fndesc, [state.library])
    return _LowerResult(made.fndesc, made.call_helper, cfunc=token, env=made.env)


class KernelCompiler(CompilerBase):  # type: ignore[misc]
    """numba's compiler in nopython mode, with our last step."""

    def define_pipelines(self) -> list[PassManager]:
        """numba's own passes, but for the one that makes code."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        steps = [(_Lowering if step is NativeLowering else step, words) for step, words in passes.passes]
        passes.passes[:] = steps
        passes.finalize()
        return [passes]
