"""Dear tests of many cases: those cases that stay fast, each named by a part of its parameters; the rest is slow.

A case stays here for what no other one shows, and where all show the same, the hardest of the cheap ones does.
All are run by the slow suite (`make slow`).  A run of the whole suite refuses a name that no test has any more.
"""

from pathlib import Path

import pytest

TESTS = Path(__file__).parent
# fmt: off
FAST: dict[str, dict[str, tuple[str, ...]]] = {
    # Pairs of frames evaluated: 1 to 3 s each
    "piv/correlation/test_evidence.py": {
        "test_crests_of_short_waves_are_kept": ("48",),
    },
    "piv/correlation/test_fill.py": {
        "test_a_fifth_of_all_pixels_dead_costs_less_than_twice_the_error": ("whole",),
        "test_strangers_do_not_become_a_pair_by_completing_each_other": ("0.2",),
    },
    "piv/correlation/test_flows.py": {
        "test_a_displacement_beyond_the_first_window_is_found_without_being_told": ("60.2",),
        "test_beside_a_step_vectors_stay_what_they_are": ("4.0",),
        "test_gain_of_waves_of_one_and_a_half_two_and_three_windows": ("48",),
        "test_peak_locking_stays_below_4_thousandths": ("1.5",),
        "test_sigma_in_the_middle_of_the_frame": ("'noise': 0.1}", "loss"),
        "test_the_response_to_oblique_waves_is_the_one_that_is_said": ("50-45.0-1.0",),
        "test_turbulence_with_known_truth": ("field-16",),
    },
    "piv/correlation/test_jets.py": {
        "test_a_core_as_wide_as_a_window_is_kept_with_a_sigma_of_its_error": ("flat core, oblique",),
        "test_a_core_of_half_a_window_has_no_vector_or_one_that_is_unsure": ("oblique",),
    },
    "piv/correlation/test_piv_accuracy.py": {
        "test_sigma_is_the_size_of_the_true_error": ("'noise': 0.03", "'loss': 0.1"),
    },
    "piv/correlation/test_resolution.py": {
        "test_both_parts_together_are_the_size_of_the_error": ("wave of 64 px", "vortex"),
    },
    "piv/statistics/test_effective_samples.py": {
        "test_sigma_of_the_mean_covers_what_it_says": ("0.5-0.15",),
    },
    # Boards rendered and found, labs drawn and fitted
    "correction/evaluate/test_vector_map_sigma.py": {
        "test_sigma_is_the_spread_of_drawn_scenes": ("True",),
    },
    "correction/fit/test_unlisted.py": {
        "test_a_stray_body_is_masked_and_little_else": ("wire", "drop"),
    },
    "correction/inversion/test_sheets.py": {
        "test_derivatives_are_those_of_the_stored_pixel_to_what_float32_holds": ("two_spheres_500", "hollow_pair"),
    },
    "correction/light_sheet/test_find_sheet.py": {
        "test_a_sheet_that_is_known_is_left_where_it_is": ("0.001",),
    },
    "correction/light_sheet/test_layers.py": {
        "test_middles_lie_where_the_simulator_draws_them": ("17",),
    },
    "correction/target/test_board_search.py": {
        "test_any_turn_is_found_with_the_right_index": ("137.0",),
        "test_discs_put_a_prediction_right_that_is_squares_off": ("17.5",),
        "test_perspective_and_distortion": ("how3",),
        "test_without_discs_in_view_the_prediction_decides": ("90.0",),
    },
    "correction/target/test_corners.py": {
        "test_noise_free_corners_are_exact_and_noisy_ones_as_good_as_they_say": ("upright", "sheared"),
    },
    # A camera's process for each case, or a whole run
    "daq/cameras/test_harvesters.py": {
        "test_a_camera_that_was_lost_between_steps_is_still_lost_when_frames_are_waited_for": ("trigger",),
        "test_a_script_needs_no_guard_and_may_stand_beside_any_file": ("leave",),
        "test_what_a_terminal_sends_is_for_the_parent_to_decide": ("1",),
    },
    "daq/cameras/test_pair_shapes.py": {
        "test_pairs_come_whole_and_of_one_pulse_each": ("double_height", "two_blocks, line", "burst, counter"),
    },
    "daq/live/test_run_shown.py": {
        "test_a_run_is_the_same_with_a_page": ("True",),
    },
    "daq/runner/test_arrival.py": {
        "test_a_controller_that_restarts_while_frames_are_taken_fails_its_step": ("portal", "target"),
    },
    "daq/runner/test_camera_lies.py": {
        "test_a_clock_that_is_another_or_cannot_be_read_still_tells_late_frames": ("kind1",),
        "test_frames_in_another_format_than_read_back_are_refused_at_the_first": ("settings1",),
    },
    "daq/runner/test_late_frames.py": {
        "test_no_frame_is_filed_under_a_stop_that_it_does_not_show": ("late_s1", "late_s2"),
    },
    "daq/runner/test_runner.py": {
        "test_ctrl_c_once_finishes_the_step_and_resume_does_the_rest": ("3",),
    },
    "daq/runner/test_streams.py": {
        "test_what_a_killed_stream_has_stays_and_the_rest_is_taken": ("37",),
    },
}
# fmt: on


def thin(items: list[pytest.Item]) -> set[str]:
    """Mark as slow what FAST leaves out; return what it names and none of these has."""
    left = {(file, test, part) for file, tests in FAST.items() for test, parts in tests.items() for part in parts}
    for item in items:
        file, test = item.path.relative_to(TESTS).as_posix(), getattr(item, "originalname", item.name)
        parts = FAST.get(file, {}).get(test, ())
        kept = [part for part in parts if part in item.name.partition("[")[2]]
        left -= {(file, test, part) for part in kept}
        if parts and not kept:
            item.add_marker(pytest.mark.slow)
    return {f"{file}::{test}[{part}]" for file, test, part in left}
