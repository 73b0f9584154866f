// Delaunay triangulations by CGAL behind a plain C interface: arrays in, arrays out. Compiled and loaded by backends.py.
#include <CGAL/Delaunay_triangulation_2.h>
#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Delaunay_triangulation_cell_base_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>
#include <CGAL/Triangulation_vertex_base_with_info_3.h>
#include <cstdint>
#include <utility>
#include <vector>

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Node = std::int64_t;
using Plane = CGAL::Delaunay_triangulation_2<
    Kernel, CGAL::Triangulation_data_structure_2<CGAL::Triangulation_vertex_base_with_info_2<Node, Kernel>>>;
using Space = CGAL::Delaunay_triangulation_3<
    Kernel, CGAL::Triangulation_data_structure_3<CGAL::Triangulation_vertex_base_with_info_3<Node, Kernel>,
                                                 CGAL::Delaunay_triangulation_cell_base_3<Kernel>>>;

// Each function writes the nodes of at most `room` cells and returns how many cells there are (to be called again with more
// room if that is larger), or -1 for an exception, which must not pass into the caller.
extern "C" std::int64_t delaunay2(Node n, const double *x, Node *cells, std::int64_t room) {
  try {
    std::vector<std::pair<Kernel::Point_2, Node>> points;
    points.reserve(n);
    for (Node i = 0; i < n; ++i) points.emplace_back(Kernel::Point_2(x[2 * i], x[2 * i + 1]), i);
    Plane t(points.begin(), points.end());
    std::int64_t m = 0;
    for (auto f = t.finite_faces_begin(); f != t.finite_faces_end(); ++f, ++m)
      for (int k = 0; k < 3 && m < room; ++k) cells[3 * m + k] = f->vertex(k)->info();
    return m;
  } catch (...) {
    return -1;
  }
}

extern "C" std::int64_t delaunay3(Node n, const double *x, Node *cells, std::int64_t room) {
  try {
    std::vector<std::pair<Kernel::Point_3, Node>> points;
    points.reserve(n);
    for (Node i = 0; i < n; ++i) points.emplace_back(Kernel::Point_3(x[3 * i], x[3 * i + 1], x[3 * i + 2]), i);
    Space t(points.begin(), points.end());
    if (t.dimension() < 3) return 0;
    std::int64_t m = 0;
    for (auto c = t.finite_cells_begin(); c != t.finite_cells_end(); ++c, ++m)
      for (int k = 0; k < 4 && m < room; ++k) cells[4 * m + k] = c->vertex(k)->info();
    return m;
  } catch (...) {
    return -1;
  }
}
