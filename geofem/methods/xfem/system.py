"""The global system: numbers of dofs over all ranks, one symmetric matrix from the standard and the enriched blocks, its solution.

Each rank numbers its standard dofs first and its enriched ones after them; an enriched dof belongs to the owner of its node.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import bsr_matrix, coo_matrix, csr_matrix

from geofem.core.solvers import LinearSolver
from geofem.cost import phase
from geofem.methods.xfem.enrichment import Enrichment
from geofem.methods.xfem.grid import Grid
from geofem.mistake import Breakdown
from geofem.scene import Array

LANCZOS = 60
"""Steps of Lanczos' method for the extreme eigenvalues: two digits, which is what a condition number is read to."""


class Numbering:
    """Where local dofs stand among those of all ranks.

    to_global : (local dofs,) standard ones first, ghosts included. owned : number of dofs of this rank, from ``first`` on.
    local_owned : (owned,) local numbers of the owned dofs, in the order of their global numbers. Made collectively.
    """

    def __init__(self, grid: Grid, enrichment: Enrichment):
        comm, nodes = grid.comm, len(grid.X)
        counts = np.array(comm.allgather((grid.owned, enrichment.owned)))
        self._first_node = np.concatenate([[0], np.cumsum(counts[:, 0])])
        self._first = np.concatenate([[0], np.cumsum(2 * counts[:, 0] + counts[:, 1])])
        self.total = int(self._first[-1])
        self.first = int(self._first[comm.rank])
        self.owned = int(2 * grid.owned + enrichment.owned)
        standard = self.standard(grid.map.local_to_global(np.arange(nodes, dtype=np.int32)))
        local = enrichment.first_dofs()
        first = grid.from_owners((self.first + 2 * grid.owned + local).astype(float)).astype(np.int64)
        inner = np.arange(enrichment.dofs)
        node = np.repeat(enrichment.node, np.diff(np.append(enrichment.entries.dof, enrichment.dofs)))
        extra = first[node] + inner - local[node]
        self.to_global = np.concatenate([np.stack([standard, standard + 1], axis=1).ravel(), extra])
        self.local_owned = np.concatenate([np.arange(2 * grid.owned), 2 * nodes + np.arange(enrichment.owned)])

    def standard(self, nodes: Array) -> Array:
        """The number of the first standard dof of nodes by their global numbers in the space."""
        rank = np.searchsorted(self._first_node, nodes, side="right") - 1
        return self._first[rank] + 2 * (nodes - self._first_node[rank])


class StandardBlock:
    """The stiffness of the mesh without cracks, assembled once: rows, columns (global node numbers) and 2 x 2 blocks."""

    def __init__(self, form: fem.Form, grid: Grid):
        matrix = fem.create_matrix(form)
        fem.assemble_matrix(matrix, form)
        matrix.scatter_reverse()
        end = matrix.indptr[grid.owned]
        rows = np.repeat(np.arange(grid.owned), np.diff(matrix.indptr[: grid.owned + 1]))
        self.rows = grid.map.local_range[0] + rows
        self.columns = matrix.index_map(1).local_to_global(matrix.indices[:end].astype(np.int32))
        self.values = matrix.data.reshape(-1, 4)[:end].copy()

    @cached_property
    def _single(self) -> csr_matrix:
        """The entries one by one, on one rank."""
        start = np.searchsorted(self.rows, np.arange(self.rows[-1] + 2))
        return bsr_matrix((self.values.reshape(-1, 2, 2), self.columns, start)).tocsr()

    def whole(self, dofs: int) -> csr_matrix:
        """The entries with rows and columns of further dofs, empty ones, on one rank."""
        one = self._single
        start = np.append(one.indptr, np.full(dofs - one.shape[0], one.indptr[-1], one.indptr.dtype))
        return csr_matrix((one.data, one.indices, start), shape=(dofs, dofs))

    def triplets(self, numbering: Numbering) -> tuple[Array, Array, Array]:
        """Global rows, columns and values of single entries."""
        rows, columns = numbering.standard(self.rows), numbering.standard(self.columns)
        return (
            (rows[:, None] + np.array([0, 0, 1, 1])).ravel(),
            (columns[:, None] + np.array([0, 1, 0, 1])).ravel(),
            self.values.ravel(),
        )


class System:
    """One stiffness matrix K, solved for prescribed dofs and forces again and again.

    Factorised afresh where cracks grow: to correct the factors of the standard block costs more (benchmarks/xfem_growth.py).

    Parameters
    ----------
    blocks : rows, columns (local dofs) and values of the enriched blocks of this rank's cells.
    held : (k,) local dofs, owned ones, that are prescribed.
    springs : further rows, columns (global dofs) and values, in rows of this rank.
    """

    def __init__(
        self,
        numbering: Numbering,
        standard: StandardBlock,
        blocks: tuple[Array, Array, Array],
        held: Array,
        space: fem.FunctionSpace,
        springs: tuple[Array, Array, Array] | None = None,
    ):
        self.numbering, self.comm = numbering, space.mesh.comm
        with phase("assembly"):
            self.K = self._assemble(standard, blocks, springs)
            x, self._b = self.K.createVecs()
            size = len(numbering.to_global)
            places = PETSc.IS().createGeneral(numbering.to_global.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
            self._local = PETSc.Vec().createSeq(size)
            self._fetch = PETSc.Scatter().create(x, places, self._local, None)
            self._x = x
            self.held = self._with_dead(held)
            self._given = np.searchsorted(self.held, held)
            self.held_places = self._place(self.held)
            self.mat = self._constrained()
        self._solver = LinearSolver(self, space, definite=True)

    def destroy(self) -> None:
        """Free all that PETSc holds. Collective."""
        self._solver.destroy()
        for of in (self.K, self.mat, self._x, self._b, self._scale, self._local, self._fetch):
            of.destroy()

    def _assemble(
        self, standard: StandardBlock, blocks: tuple[Array, Array, Array], springs: tuple[Array, Array, Array] | None
    ) -> PETSc.Mat:
        to_global = self.numbering.to_global
        parts = [(to_global[blocks[0]], to_global[blocks[1]], blocks[2]), *([springs] if springs else [])]
        if self.comm.size > 1:
            parts.append(standard.triplets(self.numbering))
        rows, columns, values = (np.concatenate(part) if len(part) > 1 else part[0] for part in zip(*parts))
        index = rows.astype(PETSc.IntType), columns.astype(PETSc.IntType)
        if self.comm.size == 1:
            # less than half the time of PETSc's own sum, which would sum the standard block anew
            whole = coo_matrix((values, index), shape=(self.numbering.total,) * 2).tocsr()
            whole = standard.whole(self.numbering.total) + whole
            whole.sort_indices()
            return PETSc.Mat().createAIJ(whole.shape, csr=(whole.indptr, whole.indices, whole.data), comm=self.comm)
        mat = PETSc.Mat().create(self.comm)
        mat.setSizes([[self.numbering.owned, self.numbering.total]] * 2)
        mat.setType("aij")
        mat.setPreallocationCOO(*index)
        mat.setValuesCOO(values, PETSc.InsertMode.ADD_VALUES)
        return mat

    def _with_dead(self, held: Array) -> Array:
        """The held dofs and those whose basis function has no energy."""
        diagonal = self.K.getDiagonal().array
        dead = self.numbering.local_owned[diagonal <= 0.0]
        return np.unique(np.concatenate([held, dead]))

    def _constrained(self) -> PETSc.Mat:
        """K with nothing but the diagonal in held rows and columns, scaled to a diagonal of ones.

        With that, the condition number of linear elements does not depend on how cells are cut (Lehrenfeld and Reusken 2017 for
        jumps; the condition number is within a factor of the least that any diagonal scaling gives, van der Sluis 1969).
        """
        mat = self.K.copy()
        mat.zeroRowsColumns(self.numbering.to_global[self.held].astype(PETSc.IntType), diag=1.0)
        self._scale = mat.getDiagonal()
        self._scale.sqrtabs()
        self._scale.reciprocal()
        mat.diagonalScale(self._scale, self._scale)
        return mat

    def solve(self, force: Array, values: Array) -> Array:
        """All local dofs, ghosts included, in balance with the owned forces.

        force : (owned dofs,) N, in global order. values : (held,) what the held dofs are given (m, or as their mode has it).
        Raises ``Breakdown`` (newton) if the matrix is singular.
        """
        place = self.held_places
        whole = np.zeros(len(place))
        whole[self._given] = values
        self._x.set(0.0)
        self._x.array[place] = whole
        self.K.mult(self._x, self._b)
        rhs = force - self._b.array
        rhs[place] = whole
        solution = self._solver.solve(self._scale.array * rhs) * self._scale.array
        solution[place] = whole
        return self.ghosted(solution)

    def _place(self, dofs: Array) -> Array:
        """The place of owned local dofs among the owned ones."""
        return self.numbering.to_global[dofs] - self.numbering.first

    def ghosted(self, owned: Array) -> Array:
        """Local dofs with ghosts from the owned ones. Collective."""
        self._x.array[:] = owned
        self._fetch.scatter(self._x, self._local, False, PETSc.ScatterMode.FORWARD)
        return self._local.array.copy()

    def sum_to_owned(self, local: Array) -> Array:
        """Sums over all ranks of what they have at local dofs, for the owned ones. Collective."""
        self._local.array[:] = local
        self._x.set(0.0)
        self._fetch.scatter(self._local, self._x, PETSc.InsertMode.ADD_VALUES, PETSc.ScatterMode.REVERSE)
        return self._x.array.copy()

    def internal_force(self, x: Array) -> Array:
        """K x at the owned dofs; x : local dofs."""
        self._x.array[:] = x[self.numbering.local_owned]
        self.K.mult(self._x, self._b)
        return self._b.array.copy()

    def dot(self, a: Array, b: Array) -> float:
        """The sum over all ranks of a b, both at owned dofs."""
        return float(self.comm.allreduce(float(a @ b), op=MPI.SUM))

    def condition(self, scaled: bool = True) -> float:
        """Condition number of the matrix, by Lanczos' method on it and on its inverse (two digits). Collective.

        scaled : with its diagonal scaled to ones, as it is solved, or as it was before. Infinite where the factors are too poor
        to solve with.
        """
        first, second = self.mat.createVecs()
        s = 1.0 if scaled else self._scale.array.copy()

        def multiply(x: Array) -> Array:
            first.array[:] = x / s
            self.mat.mult(first, second)
            return second.array / s

        try:
            return self._largest(multiply) * self._largest(lambda x: s * self._solver.solve(s * x))
        except Breakdown:
            return np.inf

    def _largest(self, apply: Callable[[Array], Array]) -> float:
        """The largest eigenvalue of a symmetric operator on owned dofs (Lanczos 1950)."""
        v = np.random.default_rng(self.comm.rank).standard_normal(self.numbering.owned)
        v /= np.sqrt(self.dot(v, v))
        before, beta = np.zeros_like(v), 0.0
        alphas, betas = [], []
        for _ in range(min(LANCZOS, self.numbering.total)):
            w = apply(v) - beta * before
            alphas.append(self.dot(w, v))
            w -= alphas[-1] * v
            beta = np.sqrt(self.dot(w, w))
            betas.append(beta)
            if beta < 1e-14 * abs(alphas[0]):
                break
            before, v = v, w / beta
        return float(np.linalg.eigvalsh(np.diag(alphas) + np.diag(betas[:-1], 1) + np.diag(betas[:-1], -1))[-1])
