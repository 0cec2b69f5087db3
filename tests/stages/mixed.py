"""The stages of the paper over four kinds of controllers: camera, 2 m rail, glass, target."""


def axis(controller, channel, carries, along, low_mm=0.0, high_mm=100.0, **more):
    usual = {
        "controller": controller, "channel": channel, "carries": carries, "along": along,
        "limits_mm": [low_mm, high_mm], "speed_mm_s": 25.0, "acceleration_mm_s2": 100.0, "settle_s": 0.2,
        "approach": {"side": "from_below", "distance_mm": 0.5, "speed_mm_s": 2.0},
    }  # fmt: skip
    return {**usual, **more}


def paper_bench():
    """The stages of the paper over four kinds of controllers: camera, 2 m rail, glass, target."""
    axes = {
        "camera_x": axis("camera", "1/1", "camera", "x", steps_per_mm=2000.0),
        "camera_y": axis("camera", "1/2", "camera", "y", steps_per_mm=2000.0),
        "rail_z": axis("rail", "X", "camera", "z", 0.0, 1900.0, steps_per_mm=320.0, home_timeout_s=600.0),
        "glass_x": axis("glass", "1", "glass", "x"),
        "glass_y": axis("glass", "2", "glass", "y"),
        "glass_z": axis("glass", "3", "glass", "z", sign=-1, offset_mm=100.0),
        "target_x": axis("target", "X", "target", "x", offset_mm=110.0),
        "target_y": axis("target", "Y", "target", "y", offset_mm=110.0),
        "target_z": axis("target", "Z", "target", "z", offset_mm=110.0),
    }
    controllers = {
        "camera": {"driver": "zaber_ascii", "port": "a"}, "rail": {"driver": "isel_dnc", "port": "b"},
        "glass": {"driver": "pi_gcs2", "port": "c"}, "target": {"driver": "grbl", "port": "d"},
    }  # fmt: skip
    order = ["glass_z", "glass_y", "glass_x", "target_z", "target_y", "target_x", "rail_z", "camera_x", "camera_y"]
    return {"controllers": controllers, "axes": axes, "home_order": order}
