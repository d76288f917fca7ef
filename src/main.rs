fn main() -> std::process::ExitCode {
    lodge::cli::main()
}
