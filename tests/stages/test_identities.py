"""Two boxes of one kind on swapped cables: refused before anything moves if the bench file names them."""

from contextlib import contextmanager

import pytest

from sim.mechanics.clock import VirtualClock
from sim.stages import SimulatedStages
from stages.config import StagesTable
from stages.errors import WrongDevice
from stages.identities import confusable, require_identity
from stages.stage import Stage
from tests.stages.benches import screws, stages_table


def twins(driver, **identities):
    """Two boxes of one driver, `left` and `right`, with an axis each."""
    axis = next(iter(stages_table(driver).model_dump(exclude_unset=True)["axes"].values()))
    return StagesTable.model_validate(
        {
            "controllers": {
                name: {"driver": driver, "port": "nowhere"}
                | ({"identity": identities[name]} if name in identities else {})
                for name in ("left", "right")
            },
            "axes": {f"{name}_x": {**axis, "controller": name} for name in ("left", "right")},
            "home_order": ["left_x", "right_x"],
        }
    )


@contextmanager
def worlds(driver):
    """Yield the world of two boxes, and how to open a stage on it with some identities, cables swapped or not."""
    clock, plain = VirtualClock(), twins(driver)
    world = SimulatedStages(plain, clock, screws(plain))
    with world.in_process() as offered:

        def opened(swapped=False, **identities):
            table = twins(driver, **identities)
            ports = {name: offered.controllers[name].port for name in ("left", "right")}
            if swapped:
                ports = {"left": ports["right"], "right": ports["left"]}
            controllers = {
                name: table.controllers[name].model_copy(update={"port": ports[name]}) for name in ports
            }
            return Stage.open(table.model_copy(update={"controllers": controllers}), clock)

        yield world, opened


@pytest.mark.parametrize("driver_that_tells", ["zaber_ascii", "pi_gcs2", "thorlabs_apt"])
def test_swapped_cables_are_refused_and_nothing_moves(driver_that_tells):
    with worlds(driver_that_tells) as (world, opened):
        with opened() as stage:
            said = {name: box.identity for name, box in stage.controllers.items()}
        assert said["left"] != said["right"]
        with opened(**said) as stage:
            stage.home()
        before_mm = {name: world.true_mm(name) for name in ("left_x", "right_x")}
        with pytest.raises(WrongDevice) as refused:
            opened(swapped=True, **said)
        assert said["left"] in str(refused.value)
        assert said["right"] in str(refused.value)
        assert "cables" in str(refused.value)
        assert {name: world.true_mm(name) for name in before_mm} == before_mm
        assert not any(line.is_opened for line in world.lines.values())


def test_without_identities_they_are_taken_for_each_other():
    """The judge must be able to see what the identities prevent."""
    with worlds("zaber_ascii") as (world, opened), opened(swapped=True) as stage:
        before_mm = world.true_mm("right_x")
        stage.home(["left_x"])
        stage.move({"left_x": 60.0})
        assert abs(world.true_mm("right_x") - before_mm) > 1.0


def test_a_part_of_what_a_box_says_is_enough():
    with worlds("zaber_ascii") as (_, opened):
        with opened() as stage:
            serials = {
                name: box.identity.split("serial ")[1].split()[0] for name, box in stage.controllers.items()
            }
        opened(left=f"serial {serials['left']}").close()
        with pytest.raises(WrongDevice, match=r"the bench file says 'serial"):
            opened(left=f"serial {serials['right']}")


def test_a_box_exchanged_while_it_was_lost_is_refused(tmp_path):
    with worlds("pi_gcs2") as (world, opened):
        with opened() as stage:
            said = {name: box.identity for name, box in stage.controllers.items()}
        with opened(**said) as stage:
            world.lines["left"].unplug()
            table = stage.config.controllers
            table["left"] = table["left"].model_copy(update={"port": table["right"].port})
            stage.controllers["right"].close()
            with pytest.raises(WrongDevice):
                stage.connect("left")
            assert stage.controllers["left"].is_lost


@pytest.mark.parametrize("driver_that_tells", ["zaber_ascii", "pi_gcs2", "thorlabs_apt"])
def test_a_box_that_answers_instead_of_the_first_is_refused_although_no_file_names_it(driver_that_tells):
    with worlds(driver_that_tells) as (_, opened), opened() as stage:
        left, right = (stage.controllers[name] for name in ("left", "right"))
        right.close()
        with pytest.raises(WrongDevice) as refused:
            left.connect(stage.config.controllers["right"].port)
        assert left.identity in str(refused.value)
        assert right.identity in str(refused.value)
        assert left.is_lost
        left.connect(stage.config.controllers["left"].port)
        assert not left.is_lost


def tables(*rows):
    controllers = {
        name: {"driver": driver, "port": port} | ({"identity": words} if words else {})
        for name, driver, port, words in rows
    }
    axis = next(iter(stages_table("zaber_ascii").model_dump(exclude_unset=True)["axes"].values()))
    pi = {key: value for key, value in axis.items() if key != "steps_per_mm"} | {"channel": "1"}
    isel = axis | {"channel": "X"}
    axes = {
        f"{name}_x": {"zaber_ascii": axis, "pi_gcs2": pi, "isel_dnc": isel}[driver] | {"controller": name}
        for name, driver, *_ in rows
    }
    return StagesTable.model_validate({"controllers": controllers, "axes": axes, "home_order": list(axes)})


BY_ID = "/dev/serial/by-id/usb-FTDI_{}-if00"


@pytest.mark.parametrize(
    ("rows", "named"),
    [
        ([("a", "zaber_ascii", "1", None), ("b", "pi_gcs2", "2", None)], []),
        ([("a", "zaber_ascii", "1", None), ("b", "zaber_ascii", "2", None)], ["a and b (zaber_ascii)"]),
        ([("a", "zaber_ascii", "1", "serial 1"), ("b", "zaber_ascii", "2", "serial 2")], []),
        ([("a", "zaber_ascii", "1", "serial 1"), ("b", "zaber_ascii", "2", None)], ["b (zaber_ascii)"]),
        ([("a", "isel_dnc", "1", "iMC-S8"), ("b", "isel_dnc", "2", "iMC-S8 V2.1")], ["a and b (isel_dnc)"]),
        ([("a", "isel_dnc", BY_ID.format(1), None), ("b", "isel_dnc", BY_ID.format(2), None)], []),
        ([("a", "isel_dnc", BY_ID.format(1), None), ("b", "isel_dnc", "/dev/ttyUSB0", None)], ["b (isel_dnc)"]),
    ],
)
def test_who_would_be_taken_for_whom(rows, named):
    found = confusable(tables(*rows))
    assert len(found) == len(named)
    assert all(sentence.startswith(words) for sentence, words in zip(found, named, strict=True))


def test_any_box_will_do_if_none_is_named():
    require_identity("rail", None, "iMC-S8 V2.1", "/dev/ttyUSB0")
    require_identity("rail", "V2", "iMC-S8 V2.1", "/dev/ttyUSB0")
    with pytest.raises(WrongDevice, match=r"rail: 'iMC-S8 V2.1' answers on /dev/ttyUSB0"):
        require_identity("rail", "V3", "iMC-S8 V2.1", "/dev/ttyUSB0")
