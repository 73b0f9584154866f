"""The linear system of solids on smoothing domains: every rank fills its own rows, so that nothing is added up across ranks and the
entries are the same to the last bit on any number of them; MUMPS solves, on a pattern that is kept while the cells stay.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numba import njit
from petsc4py import PETSc

from geofem.core.solvers import FACTORISATION_ERRORS, set_defaults
from geofem.cost import phase
from geofem.methods.pfem.solid_domains import OPTIONS, Domains
from geofem.mistake import Breakdown
from geofem.scene import Array


def share(n: int, comm: MPI.Intracomm) -> tuple[int, int]:
    """This rank's part of n things in a row."""
    return n * comm.rank // comm.size, n * (comm.rank + 1) // comm.size


class System:
    """Matrix and solver over the displacement of all nodes, (n, 2), node by node.

    patterns : the domains that couple nodes; those that are filled in later must not couple others.
    """

    def __init__(self, n: int, domains: Domains, comm: MPI.Intracomm):
        self.n, self.comm = n, comm
        self.lo, self.hi = share(n, comm)
        self.start, self.column = pattern(n, domains.first, domains.node, self.lo, self.hi)
        rows = np.repeat(2 * self.start[:-1], 2) * 2
        width = np.repeat(2 * np.diff(self.start), 2)
        rows[1::2] += width[1::2]
        self.indptr = np.append(rows, 4 * self.start[-1]).astype(PETSc.IntType)
        pairs = np.stack([2 * self.column, 2 * self.column + 1], axis=1)
        self.indices = np.concatenate(
            [np.tile(pairs[a:b].ravel(), 2) for a, b in zip(self.start, self.start[1:])] or [np.empty(0)]
        ).astype(PETSc.IntType)
        self.values = np.zeros(len(self.indices))
        self.lift = np.zeros((n, 2))
        own = 2 * (self.hi - self.lo)
        self.mat = PETSc.Mat().createAIJ(((own, 2 * n), (own, 2 * n)), csr=(self.indptr, self.indices, self.values), comm=comm)
        self._set_up()

    def _set_up(self) -> None:
        self._b, self._x = self.mat.createVecs()
        self.ksp = PETSc.KSP().create(self.comm)
        set_defaults({"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps", "mat_mumps_icntl_14": 100})
        self.ksp.setFromOptions()

    def destroy(self) -> None:
        """Free what PETSc holds. Collective."""
        for of in (self.ksp, self._b, self._x, self.mat):
            of.destroy()

    def clear(self) -> None:
        self.values[:] = 0.0

    def add(self, domains: Domains, A: Array) -> None:
        """Add the stiffness of domains whose stresses change by A (d, 4, 4) with the gradient."""
        at, which = entries_of_nodes(self.n, domains.first, domains.node)
        add_rows(self.start, self.column, self.lo, self.hi, domains.first, domains.node, domains.gradient, domains.bulk, domains.volume,
                 at, which, A, self.values)  # fmt: skip

    def add_nodal(self, nodes: Array, blocks: Array) -> None:
        """Add blocks (k, 2, 2) that couple a node with itself."""
        add_blocks(self.start, self.column, self.lo, self.hi, nodes, blocks, self.values)

    def solve(self, force: Array, fixed: Array, given: Array) -> Array:
        """The change of the displacement (n, 2) that takes the forces (n, 2) away where nothing is fixed, and is as ``given`` where
        ``fixed`` (n, 2) is true. Raises ``Breakdown`` (newton). Collective."""
        with phase("solve"):
            rhs = np.where(fixed, given, force)[self.lo : self.hi]
            constrain(self.start, self.column, self.lo, self.hi, fixed, given, self.values, rhs)
            self.mat.zeroEntries()
            self.mat.setValuesCSR(self.indptr, self.indices, self.values)
            self.mat.assemble()
            self._b.array[:] = rhs.ravel()
            try:
                self.ksp.setOperators(self.mat)
                self.ksp.solve(self._b, self._x)
                failure = self.ksp.getConvergedReason() < 0
            except PETSc.Error as error:
                if error.ierr not in FACTORISATION_ERRORS:
                    raise
                failure = True
            if failure:
                self._set_up()
                raise Breakdown("newton", "the linear solver failed: the tangent may be singular")
            return gathered(self._x.array, self.n, self.comm).reshape(self.n, 2)


def gathered(own: Array, n: int, comm: MPI.Intracomm) -> Array:
    """The whole of an array of n equal parts of which every rank has its ``share``. Collective."""
    if comm.size == 1:
        return own.copy()
    bounds = [n * k // comm.size for k in range(comm.size + 1)]
    per = own.size // max(1, bounds[comm.rank + 1] - bounds[comm.rank]) if own.size else 0
    per = comm.allreduce(per, op=MPI.MAX)
    whole = np.empty(n * per, own.dtype)
    counts = np.diff(bounds) * per
    comm.Allgatherv(np.ascontiguousarray(own).ravel(), (whole, counts))
    return whole.reshape(n, *own.shape[1:]) if own.ndim > 1 else whole


@njit(**OPTIONS)
def entries_of_nodes(n: int, first: Array, node: Array) -> tuple[Array, Array]:
    """Compressed rows: (domain, entry) pairs (k, 2) in which each node appears."""
    at = np.zeros(n + 1, np.int64)
    for s in range(len(node)):
        at[node[s] + 1] += 1
    for a in range(n):
        at[a + 1] += at[a]
    fill, which = at[:-1].copy(), np.empty((len(node), 2), np.int64)
    for d in range(len(first) - 1):
        for s in range(first[d], first[d + 1]):
            a = node[s]
            which[fill[a], 0], which[fill[a], 1] = d, s
            fill[a] += 1
    return at, which


@njit(**OPTIONS)
def pattern(n: int, first: Array, node: Array, lo: int, hi: int) -> tuple[Array, Array]:
    """Compressed rows of the nodes lo to hi: the nodes that share a domain with each, sorted, itself always among them."""
    at, which = entries_of_nodes(n, first, node)
    start = np.zeros(hi - lo + 1, np.int64)
    mark = np.full(n, -1, np.int64)
    for write in range(2):
        column = np.empty(start[hi - lo] if write else 0, np.int64)
        mark[:] = -1
        k = 0
        for a in range(lo, hi):
            begin = k
            mark[a] = a
            if write:
                column[k] = a
            k += 1
            for e in range(at[a], at[a + 1]):
                d = which[e, 0]
                for s in range(first[d], first[d + 1]):
                    b = node[s]
                    if mark[b] != a:
                        mark[b] = a
                        if write:
                            column[k] = b
                        k += 1
            if write:
                column[begin:k] = np.sort(column[begin:k])
            else:
                start[a - lo + 1] = k
    return start, column


@njit(**OPTIONS)
def add_rows(
    start: Array, column: Array, lo: int, hi: int, first: Array, node: Array, gradient: Array, bulk: Array, volume: Array,
    at: Array, which: Array, A: Array, values: Array,
) -> None:  # fmt: skip
    """Add the stiffness of all domains to the rows of the nodes lo to hi."""
    place = np.empty(len(at) - 1, np.int64)
    Q = np.empty((2, 4))
    for a in range(lo, hi):
        r, width = start[a - lo], start[a - lo + 1] - start[a - lo]
        for k in range(width):
            place[column[r + k]] = k
        for e in range(at[a], at[a + 1]):
            d, s = which[e, 0], which[e, 1]
            V = volume[d]
            gx, gy, bx, by = V * gradient[s, 0], V * gradient[s, 1], V * bulk[s, 0], V * bulk[s, 1]
            for j in range(4):
                trace = A[d, 0, j] + A[d, 3, j]
                Q[0, j] = gx * A[d, 0, j] + gy * A[d, 1, j] + bx * trace
                Q[1, j] = gx * A[d, 2, j] + gy * A[d, 3, j] + by * trace
            for z in range(first[d], first[d + 1]):
                k = place[node[z]]
                for i in range(2):
                    row = 4 * r + 2 * width * i + 2 * k
                    trace = Q[i, 0] + Q[i, 3]
                    values[row] += Q[i, 0] * gradient[z, 0] + Q[i, 1] * gradient[z, 1] + trace * bulk[z, 0]
                    values[row + 1] += Q[i, 2] * gradient[z, 0] + Q[i, 3] * gradient[z, 1] + trace * bulk[z, 1]


@njit(**OPTIONS)
def add_blocks(start: Array, column: Array, lo: int, hi: int, nodes: Array, blocks: Array, values: Array) -> None:
    for e in range(len(nodes)):
        a = nodes[e]
        if lo <= a < hi:
            r, width = start[a - lo], start[a - lo + 1] - start[a - lo]
            k = np.searchsorted(column[r : r + width], a)
            for i in range(2):
                for j in range(2):
                    values[4 * r + 2 * width * i + 2 * k + j] += blocks[e, i, j]


@njit(**OPTIONS)
def constrain(start: Array, column: Array, lo: int, hi: int, fixed: Array, given: Array, values: Array, rhs: Array) -> None:
    """Rows of fixed dofs say what is given; their columns go to the right-hand side (own nodes, 2); rows of nothing say zero."""
    for a in range(lo, hi):
        r, width = start[a - lo], start[a - lo + 1] - start[a - lo]
        for i in range(2):
            row = 4 * r + 2 * width * i
            most = 0.0
            for k in range(width):
                b = column[r + k]
                for j in range(2):
                    if fixed[a, i]:
                        values[row + 2 * k + j] = 1.0 if b == a and i == j else 0.0
                    elif fixed[b, j]:
                        rhs[a - lo, i] -= values[row + 2 * k + j] * given[b, j]
                        values[row + 2 * k + j] = 0.0
                    most = max(most, abs(values[row + 2 * k + j]))
            if most == 0.0:
                own = np.searchsorted(column[r : r + width], a)
                values[row + 2 * own + i] = 1.0
                rhs[a - lo, i] = 0.0
