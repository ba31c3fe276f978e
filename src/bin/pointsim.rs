//! `pointsim`: the simulated point machine.

fn main() -> std::process::ExitCode {
    pointsd::cli::pointsim()
}
