"""The files that a new lab begins with: scene, benches and plans, written from what it knows of itself.

    lab           what a lab says of itself, checked: camera, lens, distance, balls
    arrangement   where its balls stand, and what holds them
    scene_text    scene.yaml
    bench_room    how far stages may travel around that scene
    bench_text    bench.yaml, and bench-flow.yaml with a laser; with the parts of
    stage_text    what it says of stages: of motor_stages, or of hand_stages
    plan_texts    the plans

Every text is a whole file with comments that say what to edit for the hardware of this lab.
"""
