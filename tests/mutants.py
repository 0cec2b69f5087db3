"""Faults of one line each that fast tests must notice, drawn over all packages: is a rebuild still watched?

    python -m tests.mutants                # or: make mutants
    python -m tests.mutants keep_out 17    # those whose test, snippet or number says so

Each is a snippet that stands once in the code of all packages, whatever file it is moved to; what takes its
place; and the test that fails then, sought by its name.  All happens in a copy of the checkout, never in the
checkout itself: the tests are run once as things are and must pass, and then each with its fault and must fail.
Exit 1 if a fault survives or its snippet is not found.  Who rewrites a snippet writes the same fault into its new
words here.  None is in a file whose edit compiles kernels anew.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("rtpiv", "ground", "piv", "tracer", "correction", "stages", "daq", "sim")
LONGEST_S = 300.0
PASSED, FAILED = 0, 1  # how pytest ends
# fmt: off
MUTANTS: tuple[tuple[str, str, str], ...] = (
    ('                if answer.text != "1":\n', "                if False:\n",
     "test_a_start_whose_first_answer_is_0_is_switched_off_at_once"),
    ("            if not self._flag(T0, \"STAT\"):  # last", "            if False:  # last",
     "test_nothing_leaves_after_a_person_has_ended_it"),
    ("                self.box.stand_by()\n                return", "                return",
     "test_a_run_that_is_left_alone_gives_all_its_pulses"),
    ("        self._was_stopped |= self._offs_due < 0", "        self._was_stopped |= False",
     "test_nothing_leaves_after_a_person_has_ended_it"),
    ("not in (LaserState.SAFE, LaserState.UNKNOWN, LaserState.FAULT):", "in (LaserState.FIRING,):",
     "test_nothing_leaves_after_a_person_has_ended_it"),
    ("    requests = request_off(table.port)", "    requests = []",
     "test_off_reaches_what_a_running_process_has_open"),
    ("if found != kind:", "if found == LAYOUT:", "test_other_kind_and_layout"),
    ("if len(text) <= LONGEST else", "if len(text) <= 99 * LONGEST else", "test_one_line"),
    ('own = f".{uuid4().hex}" if among_many else ""', 'own = ""',
     "test_whoever_is_ready_last_gives_the_file_its_contents"),
    ("return np.diff(np.interp(cuts, ends, moment)) * count,", "return np.diff(np.interp(cuts, ends, moment)),",
     "test_colours_have_the_mean_and_nearly_the_spread_of_the_light"),
    ("np.exp(-0.5 * ((nm - mean_nm) / sigma_nm) ** 2)", "np.exp(-1.0 * ((nm - mean_nm) / sigma_nm) ** 2)",
     "test_a_glass_shows_the_mean_index_of_what_the_camera_counts"),
    ("* FULL_WIDTH / width_nm) ** 2", "/ width_nm) ** 2",
     "test_a_white_led_has_the_mean_wavelength_of_typical_lamps"),
    ("return np.asarray(self.z_mm + a * x_mm + b * y_mm)", "return np.asarray(self.z_mm + a * x_mm - b * y_mm)",
     "test_rays_end_on_the_sheet"),
    ("rate[:, :, -3:] -= depth_mm[:, None, None]", "rate[:, :, -3:] += depth_mm[:, None, None]",
     "test_every_derivative_agrees_with_differences"),
    ("% 2 != 0, self.dots.step_mm, 0.0)", "% 2 == 0, self.dots.step_mm, 0.0)",
     "test_depths_are_those_of_rows_columns_or_fields"),
    ("4.88 * ((magnification + 1.0) / magnification * f_number) ** 2", "4.88 * (f_number / magnification) ** 2",
     "test_eq_1_both_ways"),
    ("(xy * mx - xx * my) / determinant", "(xy * mx + xx * my) / determinant",
     "test_outliers_are_found_alone_in_clusters_and_at_edges_but_gradients_are_not"),
    ("sigma = np.sqrt(1.5 / np.log(one / two))", "sigma = np.sqrt(1.0 / np.log(one / two))",
     "test_diameter_is_that_of_the_recorded_particle"),
    ("return np.where(values > limit, limit, values)", "return np.where(values > limit, 0.0, values)",
     "test_the_cap_is_median_and_two_deviations_and_leaves_nan_alone"),
    ("frame.astype(np.float32) - light.astype(np.float32", "frame.astype(np.float32) + light.astype(np.float32",
     "test_minimum_and_mean_are_brute_force_and_take_a_generator"),
    ("not ended and len(near) <= place + reach_steps", "not ended and len(near) < place + reach_steps",
     "test_it_is_brute_force_to_the_last_bit"),
    ("each, light in near if each is frame or light - floor >= dark_share * usual]", "each, light in near]",
     "test_one_dark_frame_does_not_bring_the_reflections_back"),
    ('"vorticity": (c - b, np.sqrt', '"vorticity": (c + b, np.sqrt',
     "test_a_rotation_turns_and_does_not_diverge"),
    ("normal = total[..., :2] * np.sqrt(2.0 / faster)", "normal = total[..., :2] * np.sqrt(1.0 / faster)",
     "test_sigma_of_the_mean_covers_what_it_says"),
    ("self.mean_rest + d * (n_b / total)", "self.mean_rest + d * (n_a / total)",
     "test_moments_are_those_of_exact_sums"),
    ("lost = 1.0 - moments.count / np.maximum(looked, 1)", "lost = moments.count / np.maximum(looked, 1)",
     "test_what_was_lost_may_be_anything_that_stands_around"),
    ("max(float(np.median(apart)) * 1.4826 / np.sqrt(2.0), 1e-9", "max(float(np.median(apart)) * 1.4826, 1e-9",
     "test_places_of_lone_particles_and_their_sigma"),
    ("glass[2] = stands_off - put_up[2]", "glass[2] = -put_up[2]",
     "test_a_thousand_benches_are_aligned_and_no_glass_touches"),
    ("camera[axis] = -put_up[axis]", "camera[axis] = put_up[axis]",
     "test_a_thousand_benches_are_aligned_and_no_glass_touches"),
    ("= np.stack((field.u_px - shift_px[0], field.v_px -", "= np.stack((field.u_px - shift_px[0], field.v_px +",
     "test_the_image_route_finds_the_shift_behind_the_ball"),
    ("return min(1.0, (step_px / window_px) ** 2)", "return min(1.0, step_px / window_px)",
     "test_windows_that_overlap_count_by_the_part_that_is_their_own"),
    ('return "too small" if ratio > high else "too', 'return "too small" if ratio < high else "too',
     "test_a_sigma_is_held_to_its_claim"),
    ("by_y = m * x**k * y ** max(m - 1, 0)", "by_y = k * x**k * y ** max(m - 1, 0)",
     "test_jacobian_agrees_with_differences_and_nan_stays_nan"),
    ("return (self.measured_mm - self.target_mm) *", "return (self.measured_mm + self.target_mm) *",
     "test_the_stages_of_the_paper_home_in_order_and_go_where_they_are_sent"),
    ("if looks >= (SETTLE_READINGS if stopped else 1):", "if looks >= 1:",
     "test_one_look_at_rest_after_a_stop_is_not_believed"),
    ("* 1000.0 <= self.settings.in_position_um", "* 1000.0 <= 1e3 * self.settings.in_position_um",
     "test_an_axis_that_rests_a_millimetre_off_has_not_arrived"),
    ('if status.state in ("Hold", "Door"):', 'if status.state in ("Door",):',
     "test_a_board_that_reports_to_be_held_in_a_move_was_stopped_by_a_person"),
    ("if answer.code == grbl.LOCKED:", "if answer.code == -grbl.LOCKED:",
     "test_a_jog_that_a_locked_grbl_board_refuses_takes_its_reference"),
    ('return status.position_mm[index], status.state == "Alarm"', "return status.position_mm[index], False",
     "test_a_grbl_board_that_stands_in_alarm_is_not_believed_although_its_mark_has_stayed"),
    ("code != 2:  # a refused target keeps the position", "code == 2:  # a refused target keeps the position",
     "test_an_alarm_takes_the_reference_of_a_grbl_board_although_its_mark_has_stayed"),
    ("grbl.JOG_CANCEL).to_bytes(), grbl.RealTime(grbl.RESET).to_bytes()]", "grbl.JOG_CANCEL).to_bytes()]",
     "test_what_the_watchdog_says_ends_a_reference_run_of_a_grbl_board"),
    ("if self._count != token:", "if self._count < token:", "test_the_latch_is_a_latch"),
    ("return any(not url.startswith(WITHOUT_DEVICE) for", "return all(not url.startswith(WITHOUT_DEVICE) for",
     "test_simulated_lines_of_this_process_need_none"),
    ("return -CONTACT_MM", "return -1e3", "test_contact_is_legal_where_the_file_says_so"),
    ("closest_mm < min(allowed_mm, begin_mm) - ROUNDING_MM", "closest_mm < min(allowed_mm, begin_mm) - 50.0",
     "test_a_way_through_is_seen_although_both_ends_are_free"),
    ("np.vstack([moved.edges_mm, sweep])", "np.vstack([moved.edges_mm, 0.5 * sweep])",
     "test_closest_approach_agrees_with_brute_force"),
    ("values = 0x10000 if self._has_zero else 0xFFFF", "values = 0x10000", "test_wrap_skips_zero"),
    ("0 < self._last - frame_id >= 0x10000", "0 < self._last - frame_id >= 0x20000",
     "test_a_wrap_of_16_bits_is_seen_behind_a_producer_of_any_type"),
    ('if "AcquisitionFrameRate" in map(_new_name, wanted):', "if False:",
     "test_what_is_asked_is_set_and_nothing_elsewhere"),
    ("if any(_is_selected(name, other) for other in pending):", "if False:",
     "test_what_a_refused_selector_selects_is_not_written_at_all"),
    ("for name, value in reversed(self._replaced):", "for name, value in self._replaced:",
     "test_what_cannot_be_set_is_refused_with_its_reason_and_put_back"),
    ('if call("arv_gc_feature_node_is_locked",', 'if not call("arv_gc_feature_node_is_locked",',
     "test_what_is_asked_is_set_and_nothing_elsewhere"),
    ("else os.path.realpath(port), [])", "else port, [])", "test_two_boxes_on_one_port_are_named"),
    ("if any(len(data) >= LEAST_ECHO and data in said", "if any(len(data) < LEAST_ECHO and data in said",
     "test_a_line_with_echo"),
    ("if re.search(OLD_GRBL, said):", "if not said:", "test_an_old_grbl_is_told_which_one_is_needed"),
    ("(self._settings.get(REPORTS, MACHINE_POSITIONS))", "(MACHINE_POSITIONS)",
     "test_work_positions_are_refused_before_anything_moves"),
    ('isinstance(answer, grbl.Status) and answer.state in ("Hold",',
     'isinstance(answer, grbl.Status) and answer.state in ("",',
     "test_what_was_found_shows_nothing"),
    ("if at_switch and self._was_driven_back(channel, bits):", "if False:", "test_what_was_found_shows_nothing"),
    ("NOISE_COUNTS / known.steps_per_mm)", "1.0 / known.steps_per_mm)", "test_every_move_arrives"),
    ("goes_one_way = sorted(reads_mm) in (reads_mm,", "goes_one_way = sorted(reads_mm) in ([],",
     "test_a_slowly_turned_knob_is_motion_within_the_noise"),
    ("return before not in (0, sign)", "return False", "test_a_flip_is_seen_within_two_blocks"),
    ("= all(mm is not None for mm in where.values())", "= any(mm is not None for mm in where.values())",
     "test_one_axis_that_moves_is_no_rest_whichever_it_is"),
    ("box in then.items() if other != name and box == identity]", "box in then.items() if other == name]",
     "test_swapped_cables_are_named"),
    ("(b - a for a, b in zip(before, after, strict=True)", "(a - b for a, b in zip(before, after, strict=True)",
     "test_a_displacement_goes_from_the_reference_to_the_step_in_world_directions"),
    (":= self._clock.now_s() - self._armed_s) > ARMED_S", ":= self._clock.now_s() - self._armed_s) > 1e9",
     "test_what_was_armed_long_ago_does_not_fire"),
    ("abs_tol=1.01 * self.box.least_step_us", "abs_tol=1e9 * self.box.least_step_us",
     "test_a_dt_that_reads_back_as_another_is_found_and_switched_off"),
    ("if not 1 <= pairs <= most", "if not 0 <= pairs <= most", "test_a_chunk_is_at_most_ten_seconds"),
    ("= (q_switch_us - head.lamp_to_q_switch_us[number],", "= (q_switch_us + head.lamp_to_q_switch_us[number],",
     "test_each_lamp_leads_its_q_switch"),
    ("= max(begin_a_us, begin_b_us - dt_us) + margin_us", "= max(begin_a_us, begin_b_us - dt_us) - margin_us",
     "test_light_falls_into_both_exposures_or_is_refused"),
    ("if timing.rate_hz > exposures.max_rate_hz", "if timing.rate_hz > 9 * exposures.max_rate_hz",
     "test_what_does_not_go_together_is_refused"),
    ("return max(self._exposed_ns, self._read_ns - exposure_ns)", "return self._exposed_ns",
     "test_exposure_overlaps_the_readout_before_it_but_does_not_end_in_it"),
    ("return world_s + (time.monotonic() - wall_s) * speed", "return world_s + (time.monotonic() - wall_s)",
     "test_clocks"),
    ("self.lead_error_um * 1e-3 * math.sin(2.0 * math.pi *", "self.lead_error_um * 1e-3 * math.sin(math.pi *",
     "test_lead_errors_are_where_the_workshop_put_them"),
    ("max(low[1] - point[1], 0.0, point[1] - high[1])", "max(low[1] - point[1], 0.0)",
     "test_distances_one_can_see"),
    ("if now_s - stop.begin_s <= STOP_S:", "if now_s - stop.begin_s <= 99.0:",
     "test_a_plug_that_is_pulled_in_the_moment_of_a_stop_may_keep_it_away"),
    ("if outside_mm > allowed_mm:", "if outside_mm > allowed_mm + 1.0:", "test_limits_are_limits_of_the_carriage"),
    ("1 - math.floor(math.log10(sigma)), 0), MOST_PLACES)", "-math.floor(math.log10(sigma)), 0), MOST_PLACES)",
     "test_numbers_stand_to_the_second_digit_of_their_sigma"),
    ("@ inverse @ slope * max(scatter @ scatter / freedom, SUREST**2)))", "@ inverse @ slope * SUREST**2))",
     "test_the_vertex_is_found_with_an_honest_sigma"),
    ("total = np.sqrt(np.square(np.nan_to_num(parts)).sum(axis=0))", "total = np.nan_to_num(parts[0])",
     "test_what_the_map_is_unsure_of_counts_for_the_coverage"),
    ("_uv(np.sqrt(np.mean(np.square(known", "_uv(np.sqrt(np.mean(np.square(known - known.mean(axis=0)",
     "test_without_a_known_shift_it_is_an_uncertainty"),
    ("if not first_time and identity != self.identity:", "if first_time and identity != self.identity:",
     "test_a_box_that_answers_instead_of_the_first_is_refused_although_no_file_names_it"),
    ("drift_ns = DRIFT * abs(now_ns - self.at_ns)", "drift_ns = 0.0",
     "test_clocks_that_drift_apart_for_ten_minutes_leave_a_frame_its_trigger"),
    ("least_range = NOISES * _noise(values[usable])", "least_range = _noise(values[usable])",
     "test_noise_alone_stays_low"),
    ("last is not None and meta.sequence <= last.sequence", "last is not None and meta.sequence < last.sequence",
     "test_halves_of_a_camera_without_a_clock_are_pairs_and_one_that_comes_twice_is_doubled"),
    ("x_mm = grid.origin_mm[0] + field.x_px *", "x_mm = grid.origin_mm[0] - field.x_px *",
     "test_a_vector_is_drawn_where_it_was_measured"),
    ("reach * axis[1] + v * pitch", "reach * axis[1] - v * pitch",
     "test_a_corrected_pixel_is_the_pixel_of_a_camera_straight_above"),
    ("self._latch.stop(why)", "self._latch.count",
     "test_a_stop_between_two_words_of_a_beginning_burst_lets_none_of_the_others_switch_on"),
    ("self.box.silence()", "self.box.drop()", "test_what_cannot_be_read_is_unknown_and_only_safe_is_left"),
    ("self._enter(Event.STILL)", "self._enter(Event.OFF)",
     "test_a_burst_made_endless_at_the_keys_while_the_cable_is_out_is_off_with_the_first_word"),
    ("if self._latch.count != count:", "if self._latch.count < count:",
     "test_a_stop_that_comes_while_off_is_read_back_is_not_lost"),
    ("if tries >= 3 and not (box.may_be_on and self._clock.now_s() < end_s):", "if tries >= 3:",
     "test_leaving_goes_on_to_switch_off_until_the_cable_is_back"),
    ("            if box.may_be_on:\n", "            if box.is_lost and not box.may_be_on:\n",
     "test_leaving_a_laser_that_is_out_of_reach_says_that_it_may_still_give_light"),
    ("self._try_stop(str(error) or type(error).__name__)", "self._mark_unknown(str(error))",
     "test_a_start_whose_first_answer_is_0_is_switched_off_at_once"),
    ("if self.box.is_lost:", "if not self.box.is_lost:",
     "test_a_burst_made_endless_at_the_keys_while_the_cable_is_out_is_off_with_the_first_word"),
    ("if now_s - self._asking_s.get(name, now_s) > SILENCE_S:", "if self._asking_s.get(name, now_s) > now_s:",
     "test_a_reading_that_hangs_is_no_closed_door"),
    ('return None if closed else f"the switch', 'return None if closed is not None else f"the switch',
     "test_an_open_door_is_found_before_anything_is_armed_fired_or_aligned"),
    ('return f"the switch of the {name} cannot be read"', "return None",
     "test_a_switch_that_nobody_has_read_yet_allows_nothing"),
    ("            if words := self.look(name):\n", "            if False and (words := self.look(name)):\n",
     "test_a_door_that_opens_is_dark_within_50_ms_of_its_reading"),
    ("            if seen.pulses != pairs:\n", "            if seen.pulses < pairs:\n",
     "test_no_box_that_is_wrong_in_one_way_is_certified"),
    ("            if given.pulses not in expected:\n", "            if False:\n",
     "test_no_box_that_is_wrong_in_one_way_is_certified"),
    ("self._not_lost_by(end_s - BEFORE_END_S)", "self._not_lost_by(end_s + 99.0)",
     "test_what_a_person_did_not_do_is_not_observed_and_certifies_nothing"),
    ("for number in [*lights[len(sent) :], *ROUNDS_AT_END * lights, *numbers[len(lights) :]]:",
     "for number in []:",
     "test_a_burst_made_endless_at_the_keys_ends_with_its_time_though_no_answer_comes"),
    ('if not self._flag(T0, "STAT"):\n', "if False:\n",
     "test_a_burst_that_somebody_ended_at_the_keys_is_not_taken_for_a_whole_one"),
    ("if said > COMMAND_SET:", "if said > 9.0:", "test_a_controller_of_gcs_3_is_refused_by_name"),
    ("if (blind_s := now_s - heard_s) > BLIND_S:", "if (blind_s := now_s - heard_s) > 1e9:",
     "test_a_computer_that_has_no_time_for_too_long_does_not_watch"),
    ("self._silence_s += min(now_s - self._looked_s, ON_TIME_S)", "self._silence_s += now_s - self._looked_s",
     "test_a_computer_that_had_no_time_is_not_a_silent_device"),
    ("odd = level - 2.0 * math.floor(0.5 * level)", "odd = level - 2.0 * math.floor(0.4 * level)",
     "test_many_corners_at_once_show_each_its_own_squares"),
    ("_shade(squares[n], between, board, index[n])", "_shade(squares[n], between, board, index[0])",
     "test_many_corners_at_once_show_each_its_own_squares"),
)
# fmt: on


def copied(folder):
    """A copy of what git knows of the checkout, as it stands."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True, text=True).stdout
    for name in filter(None, names.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def texts_of(tree):
    """Contents of all Python files of a checkout, by their path in it."""
    names = (*PACKAGES, "tests")
    found = [path for name in names for path in (tree / name).rglob("*.py")]
    return {path.relative_to(tree): path.read_text(encoding="utf-8") for path in found}


def homes_and_nodes(mutants, texts):
    """Where each snippet and each test stands; LookupError for what does not stand once."""
    product = {path: text for path, text in texts.items() if path.parts[0] in PACKAGES}
    tests = {path: text for path, text in texts.items() if path.name.startswith("test_")}
    return (
        [home_of(snippet, product) for snippet, _, _ in mutants],
        [node_of(test, tests) for _, _, test in mutants],
    )


def home_of(snippet, texts):
    """The one file of the packages that has this snippet, once."""
    found = [path for path, text in texts.items() for _ in range(text.count(snippet))]
    if len(found) != 1:
        raise LookupError(f"{snippet!r} stands {len(found)} times in the packages, and not once")
    return found[0]


def node_of(test, texts):
    """Where a test stands, as pytest names it; `test` may end in the parameters of one case."""
    line = f"\ndef {test.partition('[')[0]}("
    found = [path for path, text in texts.items() if line in text]
    if len(found) != 1:
        raise LookupError(f"{test} stands in {len(found)} files of tests, and not in one")
    return f"{found[0]}::{test}"


def run(nodes, tree):
    """How pytest ends with these tests in the copy, and the last of what it says."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n0", "-p", "no:cacheprovider", *nodes]
    # Programs that tests start are those of the copy.  Two edits within a second have one time stamp: no bytecode.
    env = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command, cwd=tree, env=env, capture_output=True, text=True, timeout=LONGEST_S * len(nodes)
        )
    except subprocess.TimeoutExpired:
        return FAILED, "took too long"
    return done.returncode, done.stdout[-2000:] + done.stderr[-2000:]


def main():
    """Apply one fault after the other and print what became of it."""
    words = sys.argv[1:]
    chosen = [
        (number, mutant)
        for number, mutant in enumerate(MUTANTS, 1)
        if not words or any(word == str(number) or word in "\n".join(mutant) for word in words)
    ]
    with tempfile.TemporaryDirectory(prefix="mutants-") as place:
        tree = copied(Path(place))
        texts = texts_of(tree)
        homes, nodes = homes_and_nodes([mutant for _, mutant in chosen], texts)
        ended, said = run(list(dict.fromkeys(nodes)), tree)
        if ended != PASSED:
            print(said, "not all of these tests pass without a fault", sep="\n")
            return 1
        killed = 0
        for (number, (snippet, fault, test)), home, node in zip(chosen, homes, nodes, strict=True):
            (tree / home).write_text(texts[home].replace(snippet, fault), encoding="utf-8")
            ended, report = run([node], tree)
            (tree / home).write_text(texts[home], encoding="utf-8")
            killed += ended == FAILED
            skipped = re.search(r"\d+ skipped", report)  # what a library that is not here would have judged
            why = f"pytest ended with {ended}" + (f", {skipped[0]} here" if skipped else "")
            said = "killed" if ended == FAILED else f"SURVIVES ({why})"
            print(f"{number:3d} {said}  {home.as_posix():42s} {test}", flush=True)
    print(f"{killed} of {len(chosen)} killed")
    return int(killed < len(chosen))


if __name__ == "__main__":
    sys.exit(main())
