"""A batch in parts, one per thread: forward and backward of a module on several cores.

PyTorch's own threads meet at the end of every operation, thousands of times per update; where another process needs a
core, each meeting waits for the scheduler. These meet twice per batch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
from torch import Tensor, nn

Encode = Callable[[dict[str, Tensor]], Tensor]


def in_parts(module: nn.Module, encode: Encode, observations: dict[str, Tensor], threads: int) -> Tensor:
    """(B,F) what `encode`, a method of `module`, makes of observations (B,...), with gradients of its parameters."""
    features: Tensor = _InParts.apply(encode, observations, threads, *module.parameters())
    return features


class _InParts(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, encode: Encode, observations: dict[str, Tensor], threads: int, *parameters: Tensor) -> Tensor:
        split = {name: value.tensor_split(threads) for name, value in observations.items()}
        inputs = [{name: pieces[i] for name, pieces in split.items()} for i in range(threads)]
        ctx.parameters, ctx.parts = parameters, _in_threads(encode, inputs)
        return torch.cat([part.detach() for part in ctx.parts])

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Any:
        def of_part(part: Tensor, own: Tensor) -> tuple[Tensor | None, ...]:
            found: tuple[Tensor | None, ...] = torch.autograd.grad(part, ctx.parameters, own, allow_unused=True)
            return found

        pieces = gradient.split([len(part) for part in ctx.parts])
        by_parameter = zip(*_in_threads(of_part, ctx.parts, pieces), strict=True)
        return None, None, None, *(_total(gradients) for gradients in by_parameter)


def _total(gradients: tuple[Tensor | None, ...]) -> Tensor | None:
    """The sum over the parts, in their order; None for a parameter that has no influence."""
    there = [gradient for gradient in gradients if gradient is not None]
    return torch.stack(there).sum(0) if there else None


def _in_threads(function: Callable[..., Any], *columns: Sequence[Any]) -> list[Any]:
    """What the function returns for each row, each in a thread that ends with it: workers may be forked afterwards."""
    with ThreadPoolExecutor(len(columns[0]), initializer=torch.set_num_threads, initargs=(1,)) as pool:
        return list(pool.map(function, *columns))
