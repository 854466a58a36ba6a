"""Shapes: one file each, with everything that the tracer and the antialiasing must know of it.

A shape is an `equinox.Module` of geometry. Its arrays are scalars for one row of the scene's
tables, or one number per pixel once gathered. A shape has these methods:

- hits: `closest_hit`;
- surface: `surface`, and what `tracing/surface.py` asks for its mean over a pixel;
- shadows: `occludes`, `shadow_coverage`, `near_shadow_edge`;
- edges: `near_silhouette`, `near_crossing`, `pixel_coverage`;
- `scaled`, and `bounds` where the accelerator sorts the shape.

`tracing/tables.py` numbers the objects, and `TraceContext.fold` loops over them. Where pixels show
different shapes, `SceneTables.is_sphere` and `is_plane` choose: in `tracing/surface.py`,
`antialiasing/silhouette.py`, `shadow_edges.py`, `compositing.py` and `edge_mask.py`.
"""
