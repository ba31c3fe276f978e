//! `pointsd`: condition monitoring of railway point machines.

fn main() -> std::process::ExitCode {
    pointsd::cli::pointsd()
}
