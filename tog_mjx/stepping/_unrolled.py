"""A second copy of MJX's solver, whose iterations have derivatives. As `_mjx`, it touches what MJX keeps private."""

import ast
import functools
import importlib.util
from importlib.abc import SourceLoader
from types import ModuleType, SimpleNamespace

import jax
import jax.numpy as jnp

from tog_mjx.stepping._mjx import mjx
from tog_mjx.stepping.safe import quotient, sqrt


def unrolled_solve(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """`mjx.solve`, by the same operations in a loop of known length, which reverse mode can go back through."""
    return _unrolled_solver(model.opt.iterations).solve(model, data)


@functools.cache
def _unrolled_solver(iterations: int) -> ModuleType:
    """A second copy of MJX's module, that of others is left alone: its loop is a scan, in which iterations after the
    last do nothing, the root of a sliding speed has a derivative at zero, where an open contact is, and a step of line
    search that of its quotient, be it of two rounding errors, as where an iteration begins at the solution."""
    stock = mjx._src.solver
    spec = importlib.util.find_spec(stock.__name__)
    assert spec is not None
    assert isinstance(spec.loader, SourceLoader)
    copy = importlib.util.module_from_spec(spec)
    source = spec.loader.get_source(spec.name)
    assert source is not None
    tree = ast.fix_missing_locations(_Quotients().visit(ast.parse(source)))
    copy.quotient = quotient  # type: ignore[attr-defined]
    exec(compile(tree, stock.__file__, "exec"), copy.__dict__)

    def loop(condition, body, start):
        return stock._while_loop_scan(condition, body, start, iterations)

    copy.jax = _with(jax, lax=_with(jax.lax, while_loop=loop))  # type: ignore[attr-defined]
    copy.jp = _with(jnp, sqrt=sqrt)  # type: ignore[attr-defined]
    return copy


class _Quotients(ast.NodeTransformer):
    """Writes quotient(a, b) for a / b."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if not isinstance(node.op, ast.Div):
            return node
        return ast.Call(ast.Name("quotient", ast.Load()), [node.left, node.right], [])


def _with(module: ModuleType, **others: object) -> SimpleNamespace:
    """The names of a module, some of them for something else."""
    return SimpleNamespace(**{**vars(module), **others})
