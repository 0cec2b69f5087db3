"""Sequences in which the fuzz once found something: they show nothing any more."""

import pytest

from tests.fuzz.benches.sequences import read
from tests.fuzz.benches.stages import Playground

FOUND = {
    "a knob pressed so late that the axis brakes into the switch": (
        '[[["move",{"glass_x":18.193,"rail_z":-58.428,"camera_x":6.097}]'
        ',[["portal","answer",8,["fault","late",0.2]]]],[["move",{"glass_z":-8.766}],[]]'
        ',[["move",{"glass_z":16.596}],[]],[["home",null],[["glass","seconds",0.472,["person"]]]]'
        ',[["shove","target_z",-1.361],[]],[["home",null],[["glass","answer",7,["kill"]]]]'
        ',[["move",{"camera_x":0.402,"glass_z":1.452,"camera_y":10.87}],[]],[["where"],[]]]'
    ),
    "a person's stop at a mute box whose one word is lost": (
        '[[["shove","glass_z",-3.733],[]],[["restart","glass",0.1],[]],[["home",["glass_x","glass_z"]]'
        ',[["rail","answer",7,["fault","garbled",2.0]]]]'
        ',[["move",{"camera_x":-23.082,"glass_x":-37.516}],[]],[["move",{"glass_z":4.865}],[]]'
        ',[["move",{"rail_z":-14.006}]'
        ',[["rail","seconds",0.015,["person"]],["rail","answer",5,["fault","lost",2.0]]]]'
        ',[["resume","portal"],[]]]'
    ),
    "a knob pressed while a broken answer is being recovered from": (
        '[[["slip","glass_z",-0.372],[]],[["wait",0.01],[]],[["move",{"camera_y":25.088}],[]]'
        ',[["move",{"target_z":0.51}],[]],[["move",{"glass_z":38.841}]'
        ',[["glass","answer",6,["fault","split",0.55]],["glass","write",11,["person"]]]],[["clear"],[]]]'
    ),
    "a reference run beside a motion whose port was lost": (
        '[[["move",{"target_z":14.906}],[["target","answer",12,["fault","cut",2.0]]]],[["clear"],[]]'
        ',[["move",{"glass_x":2.1}],[["glass","answer",6,["unplug"]]]],[["plug","glass"],[]]'
        ',[["home",["target_z"]],[]]]'
    ),
    "a wheel touched so late that the axis brakes into the switch": (
        '[[["home",null],[["side","seconds",0.14,["person"]]]],[["home",["camera_x","camera_y"]],[]]]'
    ),
    "a wheel turned against the motion until the switch ends it": (
        '[[["move",{"target_x":34.857}],[["side","answer byte",173,["turn","target_x",-2.914]]]]'
        ',[["home",["target_x"]],[]]]'
    ),
    "a feed hold between the last look and the command to home, which our own reset released": (
        '[[["home",["camera_x","camera_y"]],[["portal","answer byte",8,["person"]]]],[["home",null],[]]]'
    ),
    "a line that begins to echo before a program starts": '[[["echo","portal",true],[]],[["program"],[]]]',
    "half a target of a killed program that the next one's words complete": (
        '[[["move",{"camera_y":-15.052}],[]],[["move",{"target_x":12.71}],[["side","byte",108,["kill"]]]]]'
    ),
}


@pytest.mark.parametrize("what", FOUND)
def test_what_was_found_shows_nothing(what):
    assert Playground().play(read(FOUND[what])).findings == []
