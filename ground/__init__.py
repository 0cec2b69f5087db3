"""The ground floor: what is neither optics nor hardware, and what every other package stands on.

    config        YAML files read strictly, every problem with its line
    plain_words   what is wrong with a value, in the words of who wrote it
    short_repr    one line for a value that holds arrays
    plain_file    files that are files, never pipes or devices
    whole_file    files that are whole or not there
    memory        what needs more than is free is refused before it begins
    map_file      arrays in a file, nothing trusted
    rows          a kernel over the rows of an image, on all cores
    jit           compiling of kernels: options, cache, news, and code that came with a wheel

Nothing here knows a scene, a camera or a stage; what only one package needs lives there.
"""
