"""PyTorch trains through contact: J as a function of tensors, its values and gradients from C MuJoCo.

`python scripts/examples/torch_function.py` lets torch.optim.Adam push the cube of push.py to its goal, and prints J as
it falls. Needs `pip install torch`, which nothing of the project depends on.

The place of the ball at three moments is two tensors here, along x and along y: whatever torch computes x from, a stack
of tensors or a network, gets its part of the gradient by torch's own rules. J is computed in float64; its value and its
gradient come back in the precision of x, and on its device.
"""

from collections.abc import Callable

import jax
import torch
from push import push
from torch.autograd.function import once_differentiable

import tog_mjx as tog


def tensor_function(J: Callable) -> Callable:
    """J, a JAX function of an array [n], as a function of a tensor [n] that torch differentiates once."""
    value, gradient = jax.jit(J), jax.jit(jax.grad(J))

    def at(function: Callable, x: torch.Tensor) -> torch.Tensor:
        """By DLPack, which shares memory: nothing is copied that is in float64 on the CPU already."""
        with jax.enable_x64(True):
            found = function(jax.dlpack.from_dlpack(x.detach().cpu().double().contiguous()))
        return torch.from_dlpack(found).to(x)

    class Function(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            ctx.save_for_backward(x)
            return at(value, x)

        @staticmethod
        @once_differentiable
        def backward(ctx, slope):
            return slope * at(gradient, *ctx.saved_tensors)

    return Function.apply


def main(updates: int = 40) -> tuple[float, float]:
    J = tensor_function(tog.objective(push(), "mujoco"))
    along, across = torch.full((3,), 0.2, requires_grad=True), torch.zeros(3, requires_grad=True)
    optimizer = torch.optim.Adam([along, across], lr=0.03)
    costs = []
    for i in range(updates + 1):
        cost = J(torch.stack([along, across], dim=1).flatten())  # x and y at the first moment, then at the second
        costs.append(cost.item())
        if i % 10 == 0:
            print(f"{i:3} updates: J = {costs[-1]:.4f}")
        optimizer.zero_grad()
        cost.backward()
        optimizer.step()
    return costs[0], costs[-1]


if __name__ == "__main__":
    main()
