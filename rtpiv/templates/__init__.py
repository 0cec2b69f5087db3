"""The files that a new lab begins with: scene, benches and plans, written from what it knows of itself.

    lab           what a lab says of itself, checked: camera, lens, distance, balls
    arrangement   where its balls stand, and what holds them
    scene_text    scene.yaml
    stage_text    what bench.yaml says of stages, motors or hands, and how far they may travel
    bench_text    bench.yaml, and bench-flow.yaml with a laser
    plan_texts    the plans

Every text is a whole file with comments that say what to edit for the hardware of this lab.
"""
