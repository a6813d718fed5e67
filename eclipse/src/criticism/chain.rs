//! Effects one after the other on the tape, in the order light meets them.

use std::sync::Arc;

use autodiff::{Differentiable, Graph, GraphError, Program, RunError, Sizes, Workspace};

use super::effects::{Effect, Recorded, Term};

/// One effect of a chain with its terms.
#[derive(Clone)]
pub struct Link {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Its numbers and fields.
    pub terms: Arc<Vec<Term>>,
}

/// The values that leave the sensor as a function of those the ideal model forms.
pub struct Chain {
    links: Vec<Link>,
    program: Program,
    ws: Workspace<f32>,
    /// Of effects whose numbers enter as a sum only: the derivative of the values by that sum, once it has been asked for.
    by_sum: Vec<Option<Vec<f32>>>,
}

impl Chain {
    /// Of these effects, sorted by where they act, for `observations` observations.
    ///
    /// # Errors
    /// When the tape does not compile or refuses a field, which would be a bug.
    pub fn new(links: &[Link], observations: usize) -> Result<Self, ChainError> {
        let mut links: Vec<Link> = links.to_vec();
        links.sort_by_key(|link| link.effect.stage());
        let g = Graph::new();
        let colour = g.axis("colour");
        let observation = g.domain("observation");
        let mut value = g.param_along("ideal", &observation, 1, &colour);
        for (l, link) in links.iter().enumerate() {
            let mut recorded: Vec<Recorded> = (0..link.terms.len())
                .map(|k| Recorded {
                    beta: g.param(&beta(l, k), &g.uniform(), 1),
                    field: g.input_along(&format!("field {l} {k}"), &observation, 1, &colour),
                })
                .collect();
            if by_one_sum(link) {
                // A number that is always zero: its derivative is that by the sum of all.
                recorded.push(Recorded {
                    beta: g.param(&sum(l), &g.uniform(), 1),
                    field: g.input_along(&format!("ones {l}"), &observation, 1, &colour),
                });
            }
            value = link.effect.record(&value, &recorded);
        }
        // An output is a value of its own even when there is no effect at all.
        let value = value.affine(1.0, 0.0);
        let program = g.compile::<_, Differentiable>(&[("value", &value)])?;
        let sizes = Sizes::new()
            .lanes("observation", observations)
            .axis("colour", 3);
        let mut ws = program.workspace::<f32>(&sizes)?;
        for (l, link) in links.iter().enumerate() {
            if by_one_sum(link) {
                ws.set(&sum(l), &[0.0])?;
                ws.set(&format!("ones {l}"), &vec![1.0; 3 * observations])?;
            }
            for (k, term) in link.terms.iter().enumerate() {
                ws.set(&format!("field {l} {k}"), &term.field)?;
            }
        }
        let by_sum = vec![None; links.len()];
        Ok(Self {
            links,
            program,
            ws,
            by_sum,
        })
    }

    /// Its effects in the order light meets them.
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// Binds the ideal values and the effects' numbers, `betas[link][term]`.
    ///
    /// # Errors
    /// As [`Chain::new`].
    pub fn bind(&mut self, ideal: &[f32], betas: &[Vec<f64>]) -> Result<(), ChainError> {
        self.by_sum.fill(None);
        self.ws.set("ideal", ideal)?;
        for (l, betas) in betas.iter().enumerate() {
            for (k, b) in betas.iter().enumerate() {
                self.ws.set(&beta(l, k), &[*b as f32])?;
            }
        }
        Ok(())
    }

    /// The values that leave the sensor.
    ///
    /// # Errors
    /// As [`Chain::new`].
    pub fn values(&mut self) -> Result<Vec<f32>, ChainError> {
        self.program.forward(&mut self.ws)?;
        Ok(self.ws.output("value")?.to_vec())
    }

    /// The derivative of each value by the ideal one.
    ///
    /// # Errors
    /// As [`Chain::new`].
    pub fn slope(&mut self, observations: usize) -> Result<Vec<f32>, ChainError> {
        let ones = vec![1.0; 3 * observations];
        self.program.jvp(&mut self.ws, &[("ideal", &ones)])?;
        Ok(self.ws.tangent("value")?.to_vec())
    }

    /// The derivative of the values by number `term` of effect `link`.
    ///
    /// # Errors
    /// As [`Chain::new`].
    pub fn column(&mut self, link: usize, term: usize) -> Result<Vec<f32>, ChainError> {
        let own = &self.links[link];
        if by_one_sum(own) {
            // One product for all of its numbers: there may be hundreds.
            if self.by_sum[link].is_none() {
                self.program.jvp(&mut self.ws, &[(&sum(link), &[1.0])])?;
                self.by_sum[link] = Some(self.ws.tangent("value")?.to_vec());
            }
            let by_sum = self.by_sum[link].iter().flatten();
            let pairs = by_sum.zip(&own.terms[term].field);
            return Ok(pairs.map(|(slope, field)| slope * field).collect());
        }
        self.program
            .jvp(&mut self.ws, &[(&beta(link, term), &[1.0])])?;
        Ok(self.ws.tangent("value")?.to_vec())
    }
}

fn by_one_sum(link: &Link) -> bool {
    link.effect.is_of_one_sum() && link.terms.len() > 1
}

fn sum(link: usize) -> String {
    format!("sum {link}")
}

fn beta(link: usize, term: usize) -> String {
    format!("beta {link} {term}")
}

/// The tape failed; always a bug of this program.
#[derive(Debug, thiserror::Error)]
pub enum ChainError {
    /// It did not compile.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// It refused what it was given.
    #[error(transparent)]
    Run(#[from] RunError),
}
