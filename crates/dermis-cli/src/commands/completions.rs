//! `dermis completions`: shell completions for commands and options, and manual pages.

use std::io::Write;
use std::path::PathBuf;

use clap::CommandFactory;
use clap_complete::Shell;
use dermis_skin::FileError;

use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis completions bash
  dermis completions man --out man

Bash: dermis completions bash > ~/.local/share/bash-completion/completions/dermis. Zsh: save the output as _dermis in \
a folder of $fpath. Fish: save it as ~/.config/fish/completions/dermis.fish. Manual pages: with --out \
~/.local/share/man/man1, man finds them without -M.";

/// Formats that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Target {
    /// Bash.
    Bash,
    /// Zsh.
    Zsh,
    /// Fish.
    Fish,
    /// PowerShell.
    Powershell,
    /// Elvish.
    Elvish,
    /// Manual pages, one per command.
    Man,
}

/// Arguments of `dermis completions`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// The shell, or man.
    #[arg(value_enum, value_name = "SHELL|man")]
    target: Target,
    /// Folder for manual pages.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

impl Arguments {
    /// Prints completions, or writes manual pages.
    pub fn run(&self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let shell = match self.target {
            Target::Bash => Shell::Bash,
            Target::Zsh => Shell::Zsh,
            Target::Fish => Shell::Fish,
            Target::Powershell => Shell::PowerShell,
            Target::Elvish => Shell::Elvish,
            Target::Man => return self.manual(out),
        };
        // Write in one go: a shell reading half a script would fail oddly.
        let mut script = Vec::new();
        clap_complete::generate(shell, &mut crate::Cli::command(), "dermis", &mut script);
        out.write_all(&script)?;
        Ok(Outcome::Done)
    }

    fn manual(&self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let Some(folder) = &self.out else {
            return Err(UsageError("man: expected --out FOLDER for the pages".into()).into());
        };
        let failed = |source| dermis_live::Error::Io(FileError { file: folder.clone(), source });
        std::fs::create_dir_all(folder).map_err(failed)?;
        clap_mangen::generate_to(crate::Cli::command(), folder).map_err(failed)?;
        writeln!(out, "written to {}: man -l {}", folder.display(), folder.join("dermis.1").display())?;
        Ok(Outcome::Done)
    }
}
