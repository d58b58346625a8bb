"""Kernels that only kernels call are optimised and made machine code of within their callers, not alone as well.

Numba links into a function all that it calls, optimises that and makes machine code of it: what lies at the bottom of a
step was compiled again for every kernel between it and the step, and never run but as a part of the step.
"""

from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm
from numba.core import types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher


class _Deferred(JITCodeLibrary):
    """Code that waits for its callers. What numba runs and caches of it now is empty but for its environment."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        code, codegen = self._final_module, self._codegen
        # numba writes the address of an environment into its global, used or not
        environments = [g.name for g in code.global_variables if g.name.startswith("_ZN08NumbaEnv")]
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            code.link_in(library._get_module_for_linking(), preserve=True)
        passes = llvm.create_new_module_pass_manager()
        passes.add_global_dead_code_eliminate_pass()
        passes.run(code, llvm.create_pass_builder(codegen._tm, llvm.create_pipeline_tuning_options()))
        self._finalize_dynamic_globals()  # what holds an address of this process is not cached
        for function in code.functions:
            if not function.is_declaration and function.linkage == llvm.Linkage.external:
                function.linkage = "linkonce_odr"  # every caller has a copy
        self._shared_module = code
        lines = [f"@{name} = common global ptr null" for name in environments]
        self._final_module = llvm.parse_assembly("\n".join([str(codegen._create_empty_module(self.name)), *lines]))
        self._finalize_final_module()


class _Deferring(Compiler):
    """The compiler of such kernels."""

    def define_pipelines(self) -> Any:
        state = self.state
        code = _Deferred(state.targetctx.codegen(), state.func_id.func_qualname)
        code.enable_object_caching()
        state["library"] = code
        return super().define_pipelines()


class _Inner(CPUDispatcher):
    """A constant as an argument is a number like any other: numba would make a version of all below for its value."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template([types.unliteral(kind) for kind in args], kws)


def inner_kernel(**options: Any) -> Callable[[Callable[..., Any]], _Inner]:
    """What `numba.njit` is to other kernels, cached."""

    def made(function: Callable[..., Any]) -> _Inner:
        dispatcher = _Inner(function, targetoptions={"nopython": True, **options}, pipeline_class=_Deferring)
        dispatcher.enable_caching()
        return dispatcher

    return made
