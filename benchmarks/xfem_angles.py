"""One mesh for any angle: how much the intensity factors of ``inclined_crack`` scatter as its crack turns by single degrees.

    python benchmarks/xfem_angles.py [--n 80] [--by 1]

The mesh and the matrix of the plate without its crack are made once; the crack cuts other cells at every angle. The curves
K_I = sum a_k cos 2 k beta, k = 0 to 4, and K_II = sum b_k sin 2 k beta, k = 1 to 4, are fitted to all angles: in a large plate
only the first two and the first of them are there, and the plate of the scene adds little of the next ones. What is left is
the scatter of the method; it is told as a part of |K| = hypot(K_I, K_II), which is least at 90 degrees, where it vanishes, so
up to 75 degrees only, and as a part of K_I at 0 degrees for all angles.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from geofem import methods, scenes


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--n", type=int, default=80, help="cells across the plate")
    asked.add_argument("--by", type=float, default=1.0, help="degrees between angles")
    options = asked.parse_args()
    xfem = methods.get("xfem")
    angles = np.arange(0.0, 90.0 + 1e-9, options.by)
    K, far, dofs = [], [], 0
    start = time.process_time()
    for angle in angles:
        scene = scenes.get("inclined_crack")(beta=float(angle))
        model = xfem.build(scene, n=options.n)
        model.step(1.0)
        K.append([model.probe(probe) for probe in scene.probes])
        dofs = max(dofs, model.size()["dofs"])
        errors = [abs(k - m.reference.value) for k, m in zip(K[-1], scene.measures) if m.reference is not None]
        far += [max(errors) / np.hypot(*K[-1])] if errors else []
    K, beta = np.array(K), np.radians(angles)
    bases = np.cos(2 * np.outer(beta, np.arange(5))), np.sin(2 * np.outer(beta, np.arange(1, 5)))
    left = np.stack([k - basis @ np.linalg.lstsq(basis, k, rcond=None)[0] for basis, k in zip(bases, K.T)], axis=1)
    size = np.hypot(*K.T)
    print(f"{len(angles)} angles, at most {dofs} dofs, {time.process_time() - start:.0f} s CPU")
    for name, off in zip(("K_I", "K_II"), np.abs(left).T):
        below = angles <= 75.0
        print(f"{name}: scatter of |K| up to {100 * (off / size)[below].max():.4f} % (to 75 degrees), ", end="")
        print(f"of K_I(0) up to {100 * off.max() / size[0]:.4f} %, at {angles[off.argmax()]:g} degrees")
    print(f"against the references at {len(far)} angles: up to {100 * max(far):.4f} % of |K|")


if __name__ == "__main__":
    main()
