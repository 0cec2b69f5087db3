"""Ray maps made by a renderer: a peer that traces glass in general, driven as its users would drive it.

Mitsuba follows one refracted ray a pixel, from surface to surface, until nothing is in its way; its LLVM variant
asks Embree who is met, in a masked loop that ends for each packet of rays with its last one.
"""

from collections.abc import Callable
from typing import Any

from ground.rows import thread_count
from tracer.scene.scene import Scene


def mitsuba_ray_map(scene: Scene) -> Callable[[], tuple[Any, Any]]:
    """Task that gives the plane points of all pixels by Mitsuba's LLVM variant (float32)."""
    import drjit as dr
    import mitsuba as mi

    dr.set_thread_count(thread_count())
    mi.set_variant("llvm_ad_rgb")
    parts: dict[str, Any] = {"type": "scene"}
    table = scene.sphere_table().tolist()
    for number, (x, y, z, radius, n, _) in enumerate(table):
        glass = {"type": "dielectric", "int_ior": n, "ext_ior": 1.0}
        parts[f"s{number}"] = {"type": "sphere", "center": [x, y, z], "radius": radius, "bsdf": glass}
    world = mi.load_dict(parts)
    camera = scene.camera
    height, width = camera.shape
    r, (u0, v0), focal = camera.rotation, camera.principal_px, camera.focal_px
    n = table[0][4] if table else 1.0
    if any(row[4] != n for row in table):
        raise RuntimeError("the loop below knows one index of glass")

    def bend(ray: Any, flying: Any) -> tuple[Any, Any]:  # noqa: ANN401
        met = world.ray_intersect_preliminary(ray, active=flying)
        surface = met.compute_surface_interaction(ray, active=flying)
        flying &= met.is_valid()
        inward = dr.dot(ray.d, surface.n) < 0.0
        eta = dr.select(inward, 1.0 / n, n)
        normal = dr.select(inward, surface.n, -surface.n)
        cosine = -dr.dot(ray.d, normal)
        square = 1.0 - eta * eta * (1.0 - cosine * cosine)
        root = dr.sqrt(dr.select(square > 0.0, square, 0.0))
        bent = surface.spawn_ray(dr.normalize(eta * ray.d + (eta * cosine - root) * normal))
        ray.o, ray.d = dr.select(flying, bent.o, ray.o), dr.select(flying, bent.d, ray.d)
        return ray, flying

    def task() -> tuple[Any, Any]:
        index = dr.arange(mi.UInt32, height * width)
        row = index // width
        x = (mi.Float(index - row * width) - u0) / focal
        y = (mi.Float(row) - v0) / focal
        way = mi.Vector3f(*(r[0][k] * x + r[1][k] * y + r[2][k] for k in range(3)))
        ray = mi.Ray3f(mi.Point3f(*camera.position_mm), dr.normalize(way))
        if table:
            ray, _ = dr.while_loop((ray, mi.Bool(True)), lambda _, flying: flying, bend)
        t = -ray.o.z / ray.d.z
        px, py = ray.o.x + t * ray.d.x, ray.o.y + t * ray.d.y
        dr.eval(px, py)
        dr.sync_thread()
        return px, py

    return task
