//! Why a reconstruction could not be made.

use std::path::PathBuf;

use render::mesh::MeshError;

use crate::{checkpoint::CheckpointError, settings::SettingsError, wording::amount};

use super::super::paper::PaperError;

/// Why a reconstruction could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReconstructError {
    /// Options that no run can be made with.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// Nothing is unknown of the light.
    #[error(
        "the lamps of {path} are known (`lamp` in transforms.json): reconstruct looks for unknown light and has nothing to find here; \
         to compare the photographs with their simulation, run: eclipse diagnose {path}", path = path.display()
    )]
    KnownLamps {
        /// The capture.
        path: PathBuf,
    },
    /// The capture takes more memory than a run may.
    #[error(
        "a run takes about {needed} MiB of memory even with the surface divided as coarsely as it can be, more than the {allowed} \
         allowed: give eclipse reconstruct --memory {needed}MiB or more (diagnose takes what it finds, with --reconstruction), or use \
         fewer or smaller photographs (--max-size)",
        needed = needed.div_ceil(1 << 20), allowed = amount(*allowed)
    )]
    Memory {
        /// What the coarsest plan takes, in bytes.
        needed: u64,
        /// What the settings allow, in bytes.
        allowed: u64,
    },
    /// The mesh cannot be traced.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The caller asked for the end before there was anything to keep.
    #[error("interrupted before the first step: nothing was found and nothing written")]
    Interrupted,
    /// No pixel is fit to be used.
    #[error(
        "no pixel of any photograph can be fitted; expected pixels wholly inside the masks, lit, on surface that faces the \
         camera: check the masks and the exposure, or lower --hold-out's share"
    )]
    NothingToFit,
    /// Views of the surface that are no numbers.
    #[error(
        "what the photographs tell of the light cannot be computed: it is not finite; check the scale of mesh and poses, and the \
         photographs for values that are far too large"
    )]
    NothingTold,
    /// The tape did not compile.
    #[error("the solver failed: {0}; please report this with the capture")]
    Graph(#[from] autodiff::GraphError),
    /// The tape refused its input.
    #[error("the solver failed: {0}; please report this with the capture")]
    Tape(#[from] autodiff::RunError),
    /// The paper's algorithm failed.
    #[error(transparent)]
    Paper(#[from] PaperError),
    /// The state could not be saved or used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
}

impl ReconstructError {
    /// Whether the capture, or the result to start from, is to blame and not the run.
    pub fn is_of_the_input(&self) -> bool {
        match self {
            Self::KnownLamps { .. }
            | Self::Memory { .. }
            | Self::Mesh(_)
            | Self::NothingToFit
            | Self::NothingTold => true,
            Self::Paper(error) => matches!(error, PaperError::NoPixels | PaperError::Start { .. }),
            Self::Settings(_)
            | Self::Interrupted
            | Self::Graph(_)
            | Self::Tape(_)
            | Self::Checkpoint(_) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_input_is_to_blame_for_what_it_lacks_and_not_for_the_disk() {
        assert!(ReconstructError::NothingToFit.is_of_the_input());
        assert!(ReconstructError::from(PaperError::NoPixels).is_of_the_input());
        let diverged = PaperError::Diverged {
            iteration: 7,
            loss: f64::INFINITY,
        };
        assert!(!ReconstructError::from(diverged).is_of_the_input());
        assert!(!ReconstructError::from(CheckpointError::OtherCapture).is_of_the_input());
    }
}
