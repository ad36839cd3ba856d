#include "cli.h"
namespace vdbcarve::cli { Command add_synth(CLI::App& program) { return {program.add_subcommand("synth",""), {}}; } }
